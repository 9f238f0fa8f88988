"""The site of the documentation: pages in Markdown, and a reference from the docstrings of the granumat on PYTHONPATH."""

import re

import granumat

project = "granumat"
author = copyright = "The granumat developers"
version = release = granumat.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.mathjax", "numpydoc"]
myst_enable_extensions = ["amsmath", "dollarmath"]
myst_heading_anchors = 4                         # links to headings are those of hosting pages: page.md#a-heading
html_theme = "furo"
html_static_path = ["site.css", "formulas.js", "/usr/share/javascript/katex"]
html_css_files = ["site.css", "katex.css"]
html_js_files = [(name, {"defer": "defer"}) for name in ("katex.js", "contrib/auto-render.js")]
mathjax_path, mathjax_options = "formulas.js", {"defer": "defer"}         # Debian's KaTeX in place of what comes over the net
html_title = f"granumat {version}"
html_copy_source = html_show_sphinx = smartquotes = False

highlight_language = "none"                      # of blocks that name none: what is printed
default_role = "code"                            # docstrings name things in single backquotes
autodoc_member_order = "bysource"
autodoc_typehints = "none"                       # the docstrings say types, with shapes and units
numpydoc_show_class_members = False              # autodoc lists the members


def link_files(_app, page, source):
    """Links to Markdown files outside docs/ give the file, as links to all other files do, since it is no page of the site."""
    outside = r"\.\./" * (page.count("/") + 1)
    source[0] = re.sub(rf"\[([^][]+)\]\(({outside}[^()#]+\.md)\)", r"{download}`\1 <\2>`", source[0])


def keep_bars(_app, _what, _name, _object, _options, lines):
    """The bars of a magnitude, |D|, are no substitution of reStructuredText's."""
    lines[:] = [line.replace("|", r"\|") for line in lines]


def setup(app):
    app.connect("source-read", link_files)
    app.connect("autodoc-process-docstring", keep_bars)
