"""Forces over displacements: peak, slope, work, nominal stress and strain, of closed curves."""

import numpy as np
import pytest

from surrofe2.run.responses import Response, nominal, responses

U = np.linspace(0.0, 4.0, 9)
PLACE = {
    "displacement": "mean displacement top",
    "section": 50.0,
    "length": [100.0, 200.0],
    "thickness": 10.0,
}


def history(force, u=U):
    none = np.zeros_like(u)
    return {
        "mean displacement top x": none,
        "mean displacement top y": u,
        "force grip x": none + 0.1,
        "force grip y": force,
    }


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_of_a_force_that_is_quadratic_in_the_displacement(sign):
    """Its slope at the start is exact for parabolas, its work is of second order."""
    u = sign * U
    (response,) = responses(history(30.0 * u - 3.0 * sign * u**2, u), {"grip": PLACE})
    assert (response.name, response.axis) == ("grip", "y"), "x does not move"
    assert response.slope == pytest.approx(30.0)
    assert response.work == pytest.approx(240.0 - 64.0, rel=5e-3)
    np.testing.assert_allclose(response.stress, response.force / 500.0)
    np.testing.assert_allclose(response.strain, u / 200.0)
    peak, at = f"{sign * 72:g}", f"{sign * 4:g} µm ({sign * 2:g} %)"
    assert response.sentence.startswith(f"grip y: peak {peak} µN ({sign * 0.144:g} MPa) at {at}")
    # 30 µN/µm times 200 µm over 500 µm²
    assert "slope at the start 30 µN/µm (12 MPa), work 1" in response.sentence


def test_a_slope_begins_where_a_body_touches():
    force = 20.0 * np.maximum(U - 1.0, 0.0)
    (response,) = responses(history(force), {"grip": PLACE})
    assert response.slope == pytest.approx(20.0)


def test_without_one_thickness_there_is_no_stress_and_without_motion_no_curve():
    columns = history(30.0 * U)
    place = PLACE | {"thickness": None}
    (response,) = responses(columns, {"grip": place})
    assert response.stress is None
    assert "MPa" not in response.sentence
    assert nominal(columns, {"grip": place}) == {}
    assert [*nominal(columns, {"grip": PLACE})] == [
        "nominal stress grip y",
        "nominal strain grip y",
    ]
    still = history(30.0 * U, 0.0 * U)
    assert [*responses(still, {"grip": PLACE})] == []
    assert [*responses(columns, {"other": PLACE})] == []


def test_work_is_the_area_below_the_curve():
    response = Response(
        name="grip", axis="x", displacement=U, force=2.0 * U, section=1.0, length=1.0,
        thickness=None,
    )  # fmt: skip
    assert response.work == pytest.approx(16.0)
