"""A gallery of the scripts by sphinx-gallery: each with a title, its stored picture and its source.

The scripts do not run here. Their pictures are stored beside them, and tests run them.
"""

import shutil
from pathlib import Path

ROOT = Path(__file__).parents[2]
MADE = ROOT / "out" / "scripts"
SCRIPTS = {
    "examples/cyclic_shear.py": (
        "Storage and loss modulus over frequency",
        "examples/cyclic-shear.png",
    ),
    "examples/identification.py": (
        "Constants of a plant cell from a test",
        "examples/identification.png",
    ),
    "examples/own_solver.py": ("Your own solver on a stress law", "examples/own-solver.png"),
    "examples/network_size.py": ("The size of a network", "docs/ablation.png"),
}
HEADER = """Scripts
=======

These scripts state their problems in Python, without a recipe. Each page has the whole script.
"""


def make() -> dict:
    """Folder of scripts as sphinx-gallery reads them, and its settings."""
    shutil.rmtree(MADE, ignore_errors=True)
    MADE.mkdir(parents=True)
    (MADE / "GALLERY_HEADER.rst").write_text(HEADER, encoding="utf-8")
    for name, (title, picture) in SCRIPTS.items():
        told, _, code = (ROOT / name).read_text(encoding="utf-8")[3:].partition('"""')
        shown = told.strip().replace("`", "``")
        (MADE / Path(name).name).write_text(
            f'"""\n{title}\n{"=" * len(title)}\n\n{shown}\n\n'
            f".. image:: /{picture}\n   :width: 100%\n   :alt: What the script draws\n"
            f'"""\n\n# sphinx_gallery_thumbnail_path = "{picture}"\n{code}',
            encoding="utf-8",
        )
    return {
        "examples_dirs": str(MADE),
        "gallery_dirs": str(ROOT / "docs" / "scripts"),
        "plot_gallery": False,
        "download_all_examples": False,
        "remove_config_comments": True,
        "show_signature": False,
        "write_computation_times": False,
        "min_reported_time": 1e9,
    }
