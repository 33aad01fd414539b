"""Names of folders in charts: shown as they are, by no formula and without a warning."""

import warnings

import numpy as np
import pytest

from surrofe2.run.charts import Curve, Panel, draw_panels, encoded, in_words

NAMES = (
    "a$b",
    "$\\frac",
    "cost $5 and $6",
    "叶片",
    "😀",
    "_old",
    "\u202ex",
    "\x1b[2J",
    "caf\udce9",
)


@pytest.mark.parametrize("name", NAMES, ids=ascii)
@pytest.mark.parametrize("form", ["png", "svg"])
def test_names_are_drawn_literally_and_without_a_warning(name, form):
    x = np.arange(3.0)
    curves = tuple(Curve(each, x, x, markers=False) for each in (name, f"{name} 2"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure = draw_panels([Panel("x", "y", curves, in_words(name))], title=f"Of {name}")
        picture = encoded(figure, form)
    assert len(picture) > 1000
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert labels == [in_words(name), in_words(f"{name} 2")]
    if form == "svg" and name == "cost $5 and $6":
        assert b"cost $5 and $6" in picture


def test_what_the_font_has_stays():
    assert in_words("out/bar [1] µm, café") == "out/bar [1] µm, café"
    assert in_words("叶") == "\\u53f6"
