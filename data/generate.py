"""Make the data set of a recipe: `python data/generate.py data/bending-bar.toml`.

The same as `surrofe2 generate`.
"""

from typer import run

from surrofe2.cli.learn import generate

if __name__ == "__main__":
    run(generate)
