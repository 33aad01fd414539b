"""Where plant cells are stable, with the ranges of the recipes of `data`: maps of docs/validation.

`python docs/plots/stability.py PRESET …` draws docs/stability-PRESET.png.
"""

import sys
from pathlib import Path

from surrofe2 import CellParameters, load_recipe
from surrofe2.questions.stability import stability
from surrofe2.report.study import NamedCell
from surrofe2.run.charts import draw_panels, encoded

DOCS = Path(__file__).parents[1]
RECIPES = {  # ranges that differ, of the plant cells of the presets
    "printed": ("bending-bar", "large-bar", "demo"),
    "water": ("bending-bar-water",),
    "apple": (),
}


def main(presets):
    """Draw the map of each preset."""
    for preset in presets:
        cell = CellParameters.preset(preset)
        studies = {
            name: load_recipe(DOCS.parent / "data" / f"{name}.toml").study()
            for name in RECIPES[preset]
        }
        ranges = {name: study.sampling_range() for name, study in studies.items()}
        study = stability(cell, ranges=ranges)
        title = f"{study.title}, {NamedCell(cell, preset)}"
        figure = draw_panels(study.panels, study.columns, title=title)
        (DOCS / f"stability-{preset}.png").write_bytes(encoded(figure, "png"))
        print(preset, study.table.to_markdown(), sep="\n")


if __name__ == "__main__":
    main(sys.argv[1:] or RECIPES)
