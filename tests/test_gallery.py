"""The gallery's pages: short, with their script and picture; their scripts on small meshes."""

import re
import runpy

import numpy as np
import pytest
import skfem

from surrofe2 import CellParameters, RveLaw
from surrofe2.recipe.recipe import load_recipe
from surrofe2.workflow.tissue import tissue_of
from tests.conftest import ROOT

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
    assert len(rims) == 57
    assert names["areas"](rims).sum() == pytest.approx(900.0 * 600.0)
