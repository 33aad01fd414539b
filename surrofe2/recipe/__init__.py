"""One TOML file to settings.

In reading order:

    recipe            `load_recipe`: a file to a `Recipe`, and its faults
    problem_sections  `[mesh]`, `[conditions]`, `[watch]`, `[time]`: a problem
    cell_types        `[cell]`, `[cells]`: its plant cells
    entries           values by their names
    schema            a JSON schema of all this, for editors, and new recipes
"""
