"""Train the surrogate of a recipe: `python training/train.py data/bending-bar.toml`.

The same as `surrofe2 train`.
"""

from typer import run

from surrofe2.cli.learn import train

if __name__ == "__main__":
    run(train)
