"""The table: what it answers, how it learns, and faults planted in it."""

import numpy as np
import pytest

from surrofe2.base.errors import InputError
from surrofe2.base.sampling import half_widths, sample
from surrofe2.base.square_symmetry import COMPONENT_SIGNS, INPUT_SIGNS
from surrofe2.base.tensors import from_inputs, stress_error, to_components, to_inputs, transpose
from surrofe2.cache import CachedLaw, CacheSettings, sampled_spread
from surrofe2.cache.branches import RETURN
from surrofe2.cache.table.records import (
    RULE,
    Records,
    curvature_from_constant,
    curvature_from_slopes,
    input_slopes,
    merged,
    set_bound,
    update_ellipsoids,
)
from surrofe2.law.stress_law import Status
from tests.cache.tables import RANGE, make, states, taught
from tests.laws import PointStates, SquareLaw, square_stress, tangents_by_differences
from tests.numerics import differences


def test_what_it_learnt_and_what_is_among_it_is_known_within_the_tolerance():
    learnt = states(2000)
    table, errors = taught(*learnt), []
    for F, F_dot in (learnt, sample(RANGE, 3000, 77)):
        stress, status, bound = table.lookup(F, F_dot)
        known = status == 0
        assert known.mean() > 0.99  # where a later answer made an ellipsoid shrink, one may be lost
        errors.append(stress_error(stress, square_stress(F, F_dot))[known])
        assert bound[known].max() <= table.tolerance
    assert (errors[1] > bound[known]).mean() < 0.01
    assert errors[0].max() <= table.tolerance
    assert errors[0].max() > 0.1 * table.tolerance  # linear models, not stored answers
    assert np.quantile(errors[1], 0.99) <= 0.7 * table.tolerance
    assert 10 < table.size < 100


def test_lookup_is_what_plain_numpy_gives():
    table = taught(*states(300))
    F, F_dot = states(200, angle=-1.1)
    stress, status, bound = table.lookup(F, F_dot)
    x, R = to_inputs(F, F_dot)
    records, own = table.records, table.tolerance
    d = x[:, None, None] * INPUT_SIGNS[:, None] - records.centre  # [point, image, record, input]
    bounds = np.einsum("pfni,nij,pfnj->pfn", d, records.curvature, d)
    models = records.stress + np.einsum("nki,pfni->pfnk", records.slope, d)
    inside = bounds <= own
    weight = np.where(inside, (own - bounds) / np.maximum(bounds, 1e-9 * own), 0.0) ** 2
    count = inside.sum(axis=(1, 2))
    assert min((count == 1).sum(), (count > 1).sum()) > 20
    known = count > 0
    assert (status == np.where(known, Status.OK, Status.OUT_OF_RANGE)).all()
    weight = (weight / np.maximum(weight.sum(axis=(1, 2)), 1e-300)[:, None, None])[known]
    s = np.einsum("pfn,fk,pfnk->pk", weight, COMPONENT_SIGNS, models[known])
    rotated = to_components(transpose(R) @ stress @ R)[known]
    np.testing.assert_allclose(rotated, s, atol=1e-10)
    radius = np.einsum("pfn,pfn->p", weight, np.sqrt(bounds[known] * own))
    np.testing.assert_allclose(bound[known], radius, atol=1e-10)


@pytest.mark.parametrize("allowed", [0.05, 0.045])
def test_tangents_are_the_slopes_of_the_answer(allowed):
    table = taught(*states(300)).with_tolerance(allowed, 0.0)
    F, F_dot = (np.ascontiguousarray(each) for each in states(300, angle=-1.1))
    known = (table.status_and_risk(F, F_dot, 0.9)[0] == 0) & (table.lookup(F, F_dot)[2] > 0.1)
    F, F_dot = F[known], F_dot[known]
    assert len(F) > 20
    assert (table.status_and_risk(F, F_dot)[0] == 0).all()
    tangents = table.tangents(F, F_dot)

    def stress(F, F_dot):
        return table.lookup(np.ascontiguousarray(F), np.ascontiguousarray(F_dot), 1.0)[0]

    slopes = tangents_by_differences(stress, F, F_dot, step=1e-7)
    by_F, by_F_dot = slopes.P_by_F, slopes.P_by_F_dot
    size = abs(by_F).max()
    np.testing.assert_allclose(tangents.P_by_F, by_F, atol=1e-5 * size)
    np.testing.assert_allclose(tangents.P_by_F_dot, by_F_dot, atol=1e-5 * abs(by_F_dot).max())
    exact = tangents_by_differences(square_stress, F, F_dot).P_by_F
    assert 1e-4 * size < abs(by_F - exact).max() < 0.3 * size  # those of the table, not of the law


def test_the_answer_has_no_jumps_where_there_is_one():
    """Along a line through many ellipsoids: the stress jumps nowhere by what it may be wrong."""
    table = taught(*states(2000))
    ends = [sample(RANGE, 1, seed) for seed in (5, 8)]
    t = np.linspace(0.0, 1.0, 20_001)[:, None, None]
    F, F_dot = ((1.0 - t) * a + t * b for a, b in zip(*ends, strict=True))
    stress, status, _ = table.lookup(F, F_dot)
    true = square_stress(F, F_dot)
    known = (status[1:] == 0) & (status[:-1] == 0)
    error = stress_error(stress, true)
    jump = stress_error(np.diff(stress - true, axis=0), np.zeros((len(t) - 1, 2, 2)))[known]
    assert known.mean() > 0.5
    assert np.quantile(error[status == 0], 0.9) > 0.05 * table.tolerance
    assert jump.max() < 2e-3 * table.tolerance


def test_an_answer_does_not_depend_on_the_place_among_eight_points():
    table = taught(*states(300))
    F, F_dot = sample(RANGE, 1500, 78)
    F[700] = np.nan
    whole = table.lookup(F, F_dot)
    assert 0.3 < (whole[1] == 0).mean() < 1.0
    moved = table.lookup(F[3:].copy(), F_dot[3:].copy())
    for k in range(3):
        np.testing.assert_array_equal(whole[k][3:], moved[k])


def test_lookup_is_pure_and_learning_leaves_older_records_alone():
    table = taught(*states(100))
    F, F_dot = states(100)
    before = [part.copy() for part in table.records]
    held = table.records
    first, second = table.lookup(F, F_dot), table.lookup(F, F_dot)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a, b)
    taught(*sample(RANGE, 300, 9), table)
    assert table.counts["grown"] > 0
    for a, b in zip(before, held, strict=True):
        np.testing.assert_array_equal(a, b)


def test_rotation_and_group_are_for_nothing():
    F, F_dot = states(1)
    table = taught(F, F_dot)
    assert table.size == 1
    turn, mirror = np.array([[0.0, -1.0], [1.0, 0.0]]), np.diag([1.0, -1.0])
    for G in (turn, turn @ turn, turn.T):
        same = turn @ F @ G, turn @ F_dot @ G
        stress, status, bound = table.lookup(*map(np.ascontiguousarray, same))
        assert status[0] == 0
        assert bound[0] < 1e-6
        np.testing.assert_allclose(stress, square_stress(*same), atol=1e-9)
    mirrored = mirror @ F @ mirror, mirror @ F_dot @ mirror
    np.testing.assert_allclose(table.lookup(*mirrored)[0], square_stress(*mirrored), atol=1e-9)


def test_without_symmetry_images_are_told_apart():
    F, F_dot = np.array([[[1.05, 0.0], [0.0, 1.0]]]), np.zeros((1, 2, 2))
    turned = F[:, ::-1, ::-1].copy()
    table = make(tolerance=1e-4)
    table.images = 1
    taught(F, F_dot, table)
    assert table.lookup(F, F_dot)[1][0] == 0
    assert table.lookup(turned, F_dot)[1][0] == Status.OUT_OF_RANGE
    assert taught(F, F_dot, make(tolerance=1e-4)).lookup(turned, F_dot)[1][0] == 0


def test_a_tighter_tolerance_is_answered_closer_to_the_records():
    F, F_dot = states(300)
    table = taught(F, F_dot)
    new = sample(RANGE, 500, 8)
    loose, tight = (table.lookup(*new, share * table.tolerance)[1] for share in (1.0, 0.7))
    assert (loose[tight == 0] == 0).all()
    assert 0 < (tight == 0).sum() < (loose == 0).sum()
    assert (tight[(loose == 0) & (tight != 0)] == Status.NOT_TRUSTED).all()


@pytest.mark.parametrize(
    ("F", "rate"),
    [
        (np.full((2, 2), np.nan), 0.0),
        (np.diag([1.0, -1.0]), 0.0),
        (np.eye(2), np.inf),
        (1.5 * np.eye(2), 0.0),
        (np.eye(2), 1.0),
    ],
)
def test_no_answer_to_what_is_no_deformation_or_far_off(F, rate):
    table = taught(*states(300))
    stress, status, _ = table.lookup(F[None].copy(), np.full((1, 2, 2), rate))
    assert status[0] == Status.OUT_OF_RANGE
    assert np.isnan(stress).all()


def test_a_planted_fault_is_caught_by_true_answers():
    """A slope of one record is corrupted; an audit shrinks its ellipsoid and puts a record in."""
    F, F_dot = states(300)
    table = taught(F, F_dot)
    records = table.records
    slope = records.slope.copy()
    slope[:, 0, 0] += 40.0
    table.restore(records._replace(slope=slope))
    true = square_stress(F, F_dot)
    wrong = stress_error(table.lookup(F, F_dot)[0], true) > table.tolerance
    assert wrong.mean() > 0.05
    table.learn(F, F_dot, true)
    assert table.counts["shrunk"] > 0
    stress, status, _ = table.lookup(F, F_dot)
    error = stress_error(stress, true)[status == 0]
    assert (error > table.tolerance).mean() < 0.02


def test_records_begin_warm_from_the_state_of_their_points():
    F, F_dot = states(3)
    law = SquareLaw()
    table = make(law)
    table.learn(F, F_dot, square_stress(F, F_dot), PointStates(F.copy()))
    _, start = law.asked[0]
    assert np.array_equal(start.F, np.repeat(F[:1], 8, axis=0))


def test_where_a_neighbour_fails_the_ellipsoid_is_the_small_one():
    F, F_dot = np.array([[[1.06, 0.0], [0.0, 1.0]]]), np.zeros((1, 2, 2))
    whole, cut = (taught(F, F_dot, make(SquareLaw(fails_above=above))) for above in (2.0, 1.0601))
    assert cut.size == 1
    widths = [np.sqrt(np.diag(np.linalg.inv(table.records.curvature[0]))) for table in (whole, cut)]
    assert (widths[1] < widths[0]).any()
    assert widths[1][0] < 0.5 * widths[0][0]


def test_a_point_without_tangents_gets_no_record():
    F, F_dot = np.array([[[1.06, 0.0], [0.0, 1.0]]]), np.zeros((1, 2, 2))
    table = taught(F, F_dot, make(SquareLaw(fails_above=1.05)))
    assert table.size == 0
    assert table.lookup(F, F_dot)[1][0] == Status.OUT_OF_RANGE


def test_a_full_table_takes_no_more_records_and_says_so(caplog):
    table = taught(*states(300), make(most_records=7))
    assert table.size == 7
    taught(*sample(RANGE, 300, 9), table)
    assert table.size == 7
    assert [line.split(";")[0] for line in caplog.messages] == ["the table is full with 7 records"]


def test_what_cannot_be_a_table():
    law = SquareLaw()
    law.has_tangents = False
    with pytest.raises(InputError, match="use solver direct"):
        make(law)
    with pytest.raises(InputError, match="no sample"):
        sampled_spread(SquareLaw(fails_above=0.1), RANGE)


def test_slopes_are_derivatives_along_the_inputs():
    F, F_dot = states(20)
    x, R = to_inputs(F, F_dot)
    law = SquareLaw()
    answer = law.respond(F, F_dot, tangents=True)
    slopes = input_slopes(R, *answer.tangents.cauchy(F, answer.stress))

    def rotated(x):
        return to_components(transpose(R) @ square_stress(*from_inputs(x, R)) @ R)

    np.testing.assert_allclose(slopes, differences(rotated, x, 1e-5, axes=1), atol=1e-6)


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


def random_records(count, seed=0):
    random = np.random.default_rng(seed)
    half = random.normal(size=(count, 7, 7))
    curvature = half @ np.swapaxes(half, 1, 2) + 0.5 * np.eye(7)
    return Records(
        random.normal(size=(count, 7)),
        random.normal(size=(count, 4)),
        random.normal(size=(count, 4, 7)),
        curvature,
    )


@pytest.mark.parametrize("radius", [0.5, 1.4])
def test_a_changed_ellipsoid_passes_the_point_and_changes_nowhere_else(radius):
    """In the metric of the ellipsoid only the semi-axis through the point changes."""
    records = random_records(1)
    C = records.curvature[0].copy()
    p = np.random.default_rng(2).normal(size=7)
    p *= radius / np.sqrt(p @ C @ p)
    across = np.random.default_rng(3).normal(size=(20, 7))
    across -= np.outer(across @ C @ p, p) / (p @ C @ p)
    before = np.einsum("ni,ij,nj->n", across, C, across)
    set_bound(p, 1.0, C)
    assert p @ C @ p == pytest.approx(1.0, rel=1e-12)
    np.testing.assert_allclose(np.einsum("ni,ij,nj->n", across, C, across), before, rtol=1e-10)
    assert np.linalg.eigvalsh(C).min() > 0.0


@pytest.mark.parametrize(
    ("radius", "error", "covered", "changed", "bound"),
    [
        (0.8, 0.3, True, "grown", RULE.grown),  # a right answer near by: it grows beyond it
        (1.3, 0.3, True, "grown", RULE.grown),
        (0.7, 0.3, True, None, 0.49),  # a right answer well within changes nothing
        (1.3, 0.5, False, None, 1.3**2),  # nor does a wrong or a far one beyond it
        (1.5, 0.0, False, None, 1.5**2),
        (0.9, 2.0, False, "shrunk", 3.0),  # a violation: the point is out
    ],
)
def test_an_ellipsoid_changes_by_an_rve_answer(radius, error, covered, changed, bound):
    """At a radius in the ellipsoid of tolerance 1, off by a Frobenius error. It grows so near to
    the answer that a cache takes the point back."""
    records = random_records(1)
    p = np.array([1.0, 0.3, -0.2, 0.1, 0.4, 0.0, 0.2])
    d = p * radius / np.sqrt(p @ records.curvature[0] @ p)
    x = records.centre[0] + d
    s = records.stress[0] + records.slope[0] @ d + [error * np.sqrt(2.0), 0.0, 0.0, 0.0]
    found, grown, shrunk = update_ellipsoids(x[None], s[None], 1, records, 1.0, RULE)
    assert found[0] == covered
    assert (grown, shrunk) == (changed == "grown", changed == "shrunk")
    assert d @ records.curvature[0] @ d == pytest.approx(bound)
    assert np.sqrt(RULE.grown) < RETURN


def test_first_size_is_exact_for_one_quadratic_component():
    """s₀ alone curves, by ½ xᵀHx: the bound is ½ xᵀ|H|x/√2, the Frobenius norm of its error."""
    random = np.random.default_rng(4)
    H = random.normal(size=(7, 7))
    H = H + H.T
    slope = np.zeros((1, 4, 7))
    step, reach = np.full(7, 0.1), np.linspace(1.0, 2.0, 7)
    probed = np.zeros((1, 7, 4, 7))
    probed[0, :, 0] = step[:, None] * H
    C = curvature_from_slopes(slope, probed, step, reach)[0]
    size, axes = np.linalg.eigh(reach[:, None] * H * reach)
    expected = 0.5 / np.sqrt(2.0) * (axes * np.abs(size)) @ axes.T / (reach[:, None] * reach)
    np.testing.assert_allclose(C, expected, atol=1e-10)


def test_conservative_first_size_holds_the_stress_constant():
    random = np.random.default_rng(5)
    slope, tolerance = random.normal(size=(1, 4, 7)), 0.2
    C = curvature_from_constant(slope, tolerance)[0]
    for d in random.normal(size=(50, 7)):
        edge = d * np.sqrt(tolerance / (d @ C @ d))
        assert np.sqrt(0.5 * ((slope[0] @ edge) ** 2).sum()) == pytest.approx(tolerance)


def test_no_first_ellipsoid_reaches_farther_than_the_range():
    """Along no input, though the stress is linear in some of them."""
    table = taught(*states(1))
    reach = np.sqrt(table.tolerance / np.diag(table.records.curvature[0]))
    assert (reach <= half_widths(RANGE) * (1.0 + 1e-12)).all()
    assert (reach > 0.99 * half_widths(RANGE)).any()


def test_laws_that_share_a_table_have_tolerances_of_their_own_and_learn_for_each_other():
    table = make()
    strict, lax = (
        CachedLaw(table, SquareLaw(), CacheSettings(tolerance=tolerance, audit=0.0))
        for tolerance in (1e-3, 0.1)
    )
    assert table is not strict.table is not lax.table
    F, F_dot = states(20)
    lax.accept(F, F_dot, lax.respond(F, F_dot))
    assert strict.table.size == lax.table.size == table.size > 0
    assert strict.table.counts == lax.table.counts == table.counts
    near = F + 1e-3
    risks = [law.table.lookup(near, F_dot)[2] for law in (strict, lax)]
    known = np.isfinite(risks[0])
    assert known.sum() > 10
    np.testing.assert_allclose(risks[0][known], 100.0 * risks[1][known], rtol=1e-12)
    # Records that come from a checkpoint are those of all of them, too.
    strict.table.from_arrays(make().to_arrays())
    assert strict.table.size == lax.table.size == table.size == 0
    assert lax.table.lookup(near, F_dot)[1].all()
