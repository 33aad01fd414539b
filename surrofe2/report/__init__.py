"""Reports: tables, figures and files of studies, comparisons of finished runs, and their page.

tables      one list of quantities, rendered for console, CSV, JSON and Markdown
figures     tissues with supports and rigid bodies, and plant cells
outlines    cells of an image, and an RVE like them
study       what a study hands over, and its files
comparison  runs against a reference, and its picture
chosen      numbers that a study asks of its runs
grid        a parameter study
page        runs as one HTML file, with `page.html`, `page.css` and `page.js`
"""
