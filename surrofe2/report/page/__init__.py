"""A run folder as one HTML page that needs nothing else.

seen             what a page is made of, read from run folders by the workflow
charts           panels of curves and bars as SVG pictures
html             elements, tables, figures, and the document with its policy
colours          colours of numbers and of stress sources, for Python and the script alike
motion           the deformed tissue: arrays for the script, and a still picture
outcome          displacements, forces, energies, stress and strain, costs
trust            the cache: who answered where and when, range that was met, audits
origin           plant cells, events, settings, provenance
document         all of it in order
page.css, .js    style and script, whose digests the policy names
"""
