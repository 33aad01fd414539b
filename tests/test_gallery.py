"""The gallery's pages: short, with their script and picture; their scripts on small meshes."""

import re
import runpy

import numpy as np
import pytest
import skfem

from surrofe2 import CellParameters, RveLaw, living_cell
from surrofe2.recipe.recipe import load_recipe
from surrofe2.workflow.scale import all_particles
from surrofe2.workflow.tissue import tissue_of
from tests.conftest import ROOT

try:
    import gmsh  # noqa: F401
except (ImportError, OSError):
    HAS_GMSH = False
else:
    HAS_GMSH = True

needs_gmsh = pytest.mark.skipif(
    not HAS_GMSH, reason="gmsh, of the extra dev, is not installed or lacks libGLU"
)
FOLDER = ROOT / "docs" / "gallery"
PAGES = sorted(FOLDER.glob("*.md"))


def script(name):
    return runpy.run_path(str(FOLDER / f"{name}.py"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_is_short_and_has_its_script_and_picture(page):
    text = page.read_text(encoding="utf-8")
    words = re.sub(r"```.*?```", "", text, flags=re.DOTALL).split()
    assert len(words) < 300
    assert f"({page.stem}.py)" in text
    assert f"({page.stem}.png)" in text
    assert page.with_suffix(".png").is_file()
    gallery = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    assert gallery.count(f"gallery/{page.stem}") == 3  # picture, link, contents


def test_fe2_on_one_page_converges_quadratically():
    mesh = skfem.MeshQuad1.init_tensor(np.array([0.0, 500.0]), np.array([0.0, 500.0, 1000.0]))
    law = RveLaw(CellParameters.preset("apple"))
    *_, residuals, force = script("fe2")["solve"](law, mesh.with_defaults(), shear=50.0)
    assert residuals[-1] < 1e-8
    assert residuals[-1] < 10.0 * residuals[-2] ** 2 + 1e-9
    assert force > 0.0


def test_turgor_stiffens_hexagons_and_delays_buckling():
    pressed = script("pressed_turgor")["pressed"]
    low, high = (pressed(turgor, "hexagon", (2, 2), 6) for turgor in (0.05, 0.2))
    assert high[1][1] > 2.0 * low[1][1]
    assert low[2][-1] >= high[2][-1] == 0


def test_wilting_tissue_shrinks_and_softens():
    rows = script("wilting")["wilted"](3)
    for name in ("size", "turgor", "Young's modulus along x"):
        values = [row[name] for row in rows]
        assert values == sorted(values, reverse=True)
    assert rows[0]["turgor"] == pytest.approx(0.4, rel=1e-3)


def test_the_image_of_the_gallery_has_outlines_that_fill_its_mesh():
    names = script("image_to_modulus")
    recipe = load_recipe(names["RECIPE"])
    tissue = tissue_of(recipe)
    rims = names["polygons"](tissue.outlined, tissue.outlined.arrangement.wall_position)
    labels = names["read_labels"](FOLDER / recipe.image.file)
    colours = names["colour_numbers"](labels)
    for k in (0, 1):  # where two cells touch, their colours differ
        assert (np.diff(colours, axis=k) != 0).tolist() == (np.diff(labels, axis=k) != 0).tolist()
    assert len(rims) == 57
    particles = all_particles(recipe)
    assert particles.plant_cells == 57
    assert particles.particles == 1117  # as many as the run of the page counts
    assert names["areas"](rims).sum() == pytest.approx(900.0 * 600.0)


def test_force_depends_on_wall_modulus_only_together_with_turgor():
    names = script("wall_modulus")
    columns, heights = np.array([0.0, 400.0, 1200.0]), np.array([0.0, 2000.0])

    def forces(wall_modulus, turgor=0.4):
        rest = names["pressed"](wall_modulus, turgor, columns, heights)
        return names["force_over_depth"](rest)[1]

    reference = forces(300.0)
    # stress is a function of strain and turgor/wall modulus, times the wall modulus
    assert forces(330.0, 0.44) == pytest.approx(1.1 * reference, rel=1e-3)
    # turgor matters more
    assert forces(300.0, 0.44)[-1] > forces(330.0)[-1] > 1.01 * reference[-1]
    values, _ = names["identified"](reference[1:], [280.0], forces)
    assert values[0] == pytest.approx(300.0, rel=1e-2)


def test_a_neo_hookean_solid_has_exact_slopes_and_agrees_with_cells_at_small_strain():
    names = script("own_law")
    law = RveLaw(living_cell("apple", arrangement="hexagon"))
    solid = names["like"](law)
    F = np.array([[[1.2, 0.1], [-0.05, 0.9]]])
    rest = np.zeros_like(F)
    A = solid.respond(F, rest, tangents=True).tangents.P_by_F[0]
    for c, d in np.ndindex(2, 2):
        step = np.zeros_like(F)
        step[0, c, d] = 1e-6
        sides = [solid.respond(F + x, rest).first_piola(F + x)[0] for x in (step, -step)]
        assert A[:, :, c, d] == pytest.approx((sides[0] - sides[1]) / 2e-6, rel=1e-6, abs=1e-6)
    stretched = np.array([[[1.001, 0.0005], [0.0, 1.0]]])
    stress, other = (each.respond(stretched, rest).stress for each in (law, solid))
    assert other == pytest.approx(stress, rel=0.02, abs=1e-3 * abs(stress).max())


@pytest.mark.parametrize(("strain", "sign"), [(0.15, 1), (-0.15, -1)])
def test_cells_stiffen_in_tension_and_soften_in_compression(strain, sign):
    names = script("own_law")
    law = RveLaw(living_cell("apple", arrangement="hexagon"))
    stresses = []
    for each in (law, names["like"](law)):
        rest = names["loaded"](each, strain, (2, 2), 5)
        stresses.append(names["stress_over_strain"](rest, strain)[1][-1])
    cells, solid = stresses
    assert sign * (abs(cells) / abs(solid) - 1.0) > 0.1


@needs_gmsh
def test_a_wilted_pith_softens_a_stem():
    names = script("organ")
    mesh = names["stem_mesh"](1.0)
    areas = {
        name: skfem.Basis(mesh, mesh.elem(), elements=name).dx.sum() for name in mesh.subdomains
    }
    assert areas["pith"] == pytest.approx(np.pi * 2000.0**2 / 4.0, rel=1e-3)
    turgid, wilted = (
        names["force_over_squeeze"](names["squeezed"](mesh, turgor, 4))[1][-1]
        for turgor in (0.4, 0.1)
    )
    assert turgid > 1.5 * wilted > 0.0


def test_the_modulus_of_irregular_tissue_is_that_of_its_slopes_and_depends_on_the_seed():
    names = script("scatter")
    laws = names["arrangements"](4, 2)
    moduli = []
    for law in laws.values():
        undeformed = np.eye(2)[None]
        answer = law.respond(undeformed, np.zeros_like(undeformed), tangents=True)
        # free of σ_yy and of shear, and not turned: xx, yy and yx of ∂P/∂F
        slopes = answer.tangents.P_by_F[0].reshape(4, 4)[np.ix_([0, 3, 2], [0, 3, 2])]
        modulus = names["modulus"](law)
        assert modulus == pytest.approx(0.1 / np.linalg.inv(slopes)[0, 0], rel=0.01)
        moduli.append(modulus)
    assert abs(moduli[0] / moduli[1] - 1.0) > 0.01


def test_a_petiole_is_a_layered_beam_and_buckles_sooner_the_less_turgor_it_has():
    names = script("petiole")
    mesh = names["petiole_mesh"](16)
    buckled = []
    for turgor in (0.05, 0.4):
        law_of = names["laws"](turgor)
        rest = names["bent"](law_of, 1400.0, 2, mesh)
        assert names["rigidity"](rest) == pytest.approx(names["layered_beam"](law_of), rel=0.06)
        buckled.append(rest.columns["beyond bifurcation"][-1])
    assert buckled[0] > buckled[1] == 0


def test_a_stiff_skin_resists_a_disc_and_its_cells_are_squeezed():
    names = script("puncture")
    mesh = names["half_mesh"]((4, 2), 3)
    law_of = names["laws"]()
    flesh_alone = dict.fromkeys(law_of, law_of["flesh"])
    rest, ending = names["pressed"](law_of, mesh, 200.0, 2)
    soft, _ = names["pressed"](flesh_alone, mesh, 200.0, 2)
    depth, force = names["force_over_depth"](rest)
    assert ending == "its load"
    assert depth[-1] == pytest.approx(200.0)
    assert force[-1] > names["force_over_depth"](soft)[1][-1] > 0.0
    # below the disc sap is squeezed beyond the turgor of 0.4 MPa
    squeezed = rest.element_F[:, 1, 1]
    for name, cells in zip(law_of, names["cells_below"](rest, law_of), strict=True):
        assert cells.pressure.min() > 0.4
        # of all elements of the tissue those at the disc are squeezed most
        assert cells.F[0, 1, 1] == pytest.approx(squeezed[mesh.subdomains[name]].min())


@needs_gmsh
def test_a_fruit_stretches_walls_as_it_meets_the_plate():
    names = script("dropped_fruit")
    mesh = names["fruit_mesh"](4.0)
    law_of = names["laws"](0.4)
    run = names["dropped"](law_of, mesh, 150.0, 30.0)
    hit = names["results"](run, law_of)
    # no more than the impulse that stops it, and what the force over time holds
    assert 0.0 < hit["impulse"] < hit["momentum"]
    assert hit["impulse"] == pytest.approx(np.trapezoid(hit["force"], run.curve.t), rel=0.03)
    stretch = names["stretch_of_walls"](run, law_of, mesh)
    assert stretch[-1].max() > stretch[0].max()


@pytest.mark.slow
@needs_gmsh
def test_a_dropped_fruit_rebounds():
    names = script("dropped_fruit")
    law_of = names["laws"](0.4)
    run = names["dropped"](law_of, names["fruit_mesh"](3.0), 1400.0, 40.0)
    hit = names["results"](run, law_of)
    # 1: it stays on the plate, 2: it leaves it as fast as it came
    assert 1.0 < hit["impulse"] / hit["momentum"] < 2.0
    assert run.history["force plate y"][-1] == 0.0
