"""A run folder as one HTML page that needs nothing else.

seen             what a page is made of, read from run folders by the workflow
html             elements, charts, tables, figures, and the document with its policy
bodies           rigid bodies as closed lines
motion           the deformed tissue: arrays for the script, and a still picture
outcome          displacements, forces, energies, stress and strain, costs
trust            the cache: who answered where and when, range that was met, audits
origin           plant cells, events, settings, provenance
document         all of it in order
page.css, .js    style and script, whose digests the policy names
"""
