"""Small bars: a run, a mesh of elements that are no rectangles, states at random."""

from dataclasses import asdict, replace

import numpy as np

from surrofe2 import LoadCase
from surrofe2.macro import MacroSettings, MacroState, simulate
from surrofe2.macro.equations_of_motion import EquationsOfMotion
from surrofe2.macro.system import make_system

BAR = {
    "width": 60.0, "height": 40.0, "watched": (60.0, 20.0), "elements": (2, 3), "duration": 6.0,
    "output_interval": 0.25,
}  # fmt: skip
LOAD_CASE = LoadCase(**BAR)
SETTINGS = MacroSettings(frames=13)
SQUARE = LoadCase(width=60.0, height=60.0, watched=(60.0, 30.0), elements=(2, 2))
PLATE = {"width": 30.0, "height": 20.0, "watched": (30.0, 10.0), "body_force": (0.3, -0.2)}


def with_load(problem, **changes):
    """The bar with another body force."""
    clamp, load = problem.conditions
    return replace(problem, conditions=(clamp, replace(load, **changes)))


def run_and_states(problem, law, settings=SETTINGS):
    """The run and its state after each step."""
    states = []
    run = simulate(problem, law, settings, checkpoint=states.append, checkpoint_interval=0.0)
    return run, states


def resumed(problem, law, settings, state):
    """The run from a state that went through a file's arrays."""
    return simulate(problem, law, settings, resume=MacroState.from_arrays(state.to_arrays()))


def assert_same_run(found, whole, atol=0.0):
    """Curves, energies, histories and frames of two runs, to the bit by default; and counts."""
    series = [(each.energies | each.history, asdict(each.frames)) for each in (found, whole)]
    for own, other in zip(*series, strict=True):
        assert own.keys() == other.keys()
        for name, values in other.items():
            np.testing.assert_allclose(own[name], values, rtol=0.0, atol=atol, err_msg=name)
    np.testing.assert_array_equal(found.curve.t, whole.curve.t)
    for name, curve in whole.curves.items():
        own = found.curves[name].displacement
        np.testing.assert_allclose(own, curve.displacement, rtol=0.0, atol=atol, err_msg=name)
    assert found.counts == whole.counts


def equations_of_bar(problem, law):
    return EquationsOfMotion(make_system(problem, law.density), law)


def distorted_bar(rng, elements=(5, 4), density=0.08, load=PLATE):
    """Inner nodes moved at random: elements that are no rectangles."""
    problem = LoadCase(**load, elements=elements)
    x = problem.mesh.p.T
    size = [load["width"], load["height"]]
    inner = ((x > 0.0) & (x < size)).all(axis=1)
    moved = x + inner[:, None] * rng.uniform(-0.8, 0.8, x.shape)
    return make_system(replace(problem, mesh=replace(problem.mesh, doflocs=moved.T)), density)


def random_state(system, rng, size=0.5):
    """Displacement and velocity (n, 2), zero where the system holds nodes."""
    u, v = np.zeros((2, 2 * system.n_rows))
    u[system.free], v[system.free] = rng.uniform(-size, size, (2, system.free.size))
    return u.reshape(-1, 2), v.reshape(-1, 2)


def state_vector(system, u, v):
    """y of a displacement and a velocity (n, 2)."""
    return np.concatenate([system.pick(u), system.pick(v)])
