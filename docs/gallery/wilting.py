"""Apple tissue in baths of mannitol: it loses water, shrinks and softens.

`python docs/gallery/wilting.py` prints the page's table and draws wilting.png.
"""

from pathlib import Path

from matplotlib.figure import Figure

from surrofe2 import living_cell
from surrofe2.questions.wilting import wilt
from surrofe2.run.charts import BLUE, VERMILION, encoded

SOLUTION = 2.437  # MPa per mol/l: R T at 20 °C, of a dilute solution


def wilted(points=9):
    """States of the tissue from pure water to where its turgor ends, as rows of a table."""
    return wilt(living_cell("apple", arrangement="hexagon"), points).rows()


if __name__ == "__main__":
    rows = wilted()
    bath = [abs(row["water potential"]) / SOLUTION for row in rows]  # mol/l
    print("mol/l:", *(f"{each:.3f}" for each in bath))
    for name in ("turgor", "size", "Young's modulus along x"):
        print(f"{name}:", *(f"{row[name]:.3f}" for row in rows))
    figure = Figure(figsize=(8.0, 3.4), layout="constrained")
    size, modulus = figure.subplots(1, 2)
    size.plot(bath, [100.0 * row["size"] for row in rows], "o-", color=BLUE)
    size.set(ylabel="length (% of that in water)")
    modulus.plot(bath, [row["Young's modulus along x"] for row in rows], "o-", color=VERMILION)
    modulus.set(ylabel="Young's modulus (MPa)", ylim=(0.0, None))
    for axes in (size, modulus):
        axes.set(xlabel="mannitol in the bath (mol/l)")
        axes.grid(alpha=0.25)
    Path(__file__).with_suffix(".png").write_bytes(encoded(figure, "png"))
