"""A run folder as one HTML page that needs nothing else.

report_data      what a page is made of, read from run folders by the workflow
html             elements, charts, tables, figures
motion           the deformed tissue with rigid bodies: arrays for the script, and a still picture
outcome          displacements, forces, energies, stress and strain, costs, provenance
trust            the cache: who answered where and when, range that was met, audits
document         all of it in order, in one document with its policy
page.css, .js    style and script, whose digests the policy names
"""
