"""Charts: names of folders as they are, by no formula and without a warning; notes and sketches."""

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


def test_a_note_stands_beside_its_curve_and_not_in_the_legend():
    x = np.array([1.0, 2.0])
    curves = (Curve("elastic", x, x), Curve("a", x, x), Curve("guide", x, x, note="slope 1"))
    figure = draw_panels([Panel("x", "y", curves)])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "elastic relaxation",
        "a",
    ]
    assert [text.get_text() for text in figure.axes[0].texts] == ["slope 1"]


def test_a_sketch_takes_the_place_of_curves_and_lines_are_named_once():
    x = np.array([1.0, 2.0])
    drawn = []
    curves = (Curve("a", x, x), Curve("b", x, x))
    panels = [
        Panel("", "", (), sketch=drawn.append, width=0.5),
        Panel("x", "y", curves, has_legend=False),
        Panel("x", "y", (Curve("c", x, x), Curve("d", x, x))),
    ]
    figure = draw_panels(panels, 3)
    assert drawn == [figure.axes[0]]
    assert not figure.axes[0].axison
    named = [text.get_text() for text in figure.legends[0].get_texts()]
    assert named == ["c", "d"]
