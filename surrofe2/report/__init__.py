"""Reports: tables, figures and files of studies, and comparisons of finished runs.

tables           one list of quantities, rendered for console, CSV, JSON and Markdown
figures          panels of curves in one style, as PNG
study            what a study hands over, and its files
comparison       runs against a reference
comparison_plot  their picture
particle_plot    a look into RVEs
page             runs as one HTML page
grid             a parameter study
"""
