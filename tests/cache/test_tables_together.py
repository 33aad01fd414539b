"""Tables with others: merged, and taught by a cached law."""

import numpy as np

from surrofe2.base.sampling import sample
from surrofe2.cache import CachedLaw
from surrofe2.cache.table.records import merged
from tests.cache.tables import RANGE, make, states, taught
from tests.laws import SquareLaw, square_stress


def test_merged_tables_know_what_both_know():
    first, second = taught(*states(100)), taught(*sample(RANGE, 100, 9))
    both = make()
    both.restore(merged(first.records, second.records, both.tolerance, 4))
    assert first.size < both.size <= first.size + second.size
    F, F_dot = sample(RANGE, 1000, 10)
    known = [table.lookup(F, F_dot)[1] == 0 for table in (first, second, both)]
    assert (known[0] | known[1])[known[2]].mean() == 1.0
    assert known[2].sum() > max(known[0].sum(), known[1].sum())
    again = merged(both.records, first.records, both.tolerance, 4)
    assert len(again.centre) == both.size


def test_a_merged_table_is_cut_where_the_other_knows_better():
    F, F_dot = states(200)
    table, sound = taught(F, F_dot), taught(*sample(RANGE, 300, 4))
    slope = table.records.slope.copy()
    slope[:, 0, 0] += 20.0
    records = merged(sound.records, table.records._replace(slope=slope), table.tolerance, 4)
    volume = np.linalg.det(records.curvature)
    before = np.concatenate([np.linalg.det(t.records.curvature) for t in (sound, table)])
    assert volume.sum() > 1.5 * before.sum()


def test_a_cached_law_teaches_its_table_only_at_kept_steps():
    law, kept = SquareLaw(fails_above=1.2), []
    cached = CachedLaw(make(law), law, on_true_answer=lambda *answers: kept.append(answers))
    F, F_dot = states(20, angle=0.0)
    answer = cached.respond(F, F_dot)
    assert cached.surrogate.size == 0
    assert not kept
    cached.accept(F, F_dot, answer)
    assert cached.surrogate.size > 0
    np.testing.assert_array_equal(kept[0][2], square_stress(F, F_dot))
    assert not kept[0][4].any()
    beyond = F.copy()
    beyond[0, 0, 0] = 1.5
    count = cached.surrogate.size
    cached.accept(beyond, F_dot, cached.respond(beyond, F_dot))
    assert cached.surrogate.size == count
    assert len(kept) == 1
