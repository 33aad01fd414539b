"""Recipes: one TOML file is read into settings.

In reading order:

    recipe   `load_recipe`: a file to a `Recipe`, and its faults
    entries  values by their names
    schema   a JSON schema of all this, for editors, and new recipes
"""
