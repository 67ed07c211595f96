"""The documentation's settings: `python -m sphinx -W docs build/docs`.

Made at build time: the recipe reference from the schema, the commands from their help, the gallery and the tutorials
from real runs.
"""

from __future__ import annotations

import importlib.metadata
import re
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent)]

from make_gallery import make_gallery  # noqa: E402
from make_recipes import make_recipes  # noqa: E402
from make_tutorials import make_commands, make_tutorials  # noqa: E402

project = "twin"
release = importlib.metadata.version("tactile-twin")
copyright = "the developers of twin"
extensions = ["mathml", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode", "myst_parser"]
myst_enable_extensions = ["dollarmath", "colon_fence", "attrs_inline"]
myst_heading_anchors = 2
html_math_renderer = "mathml"
html_theme = "furo"
html_show_sourcelink = False
html_title = "twin: digital twin of camera-based tactile sensors"
html_static_path = ["docs_style.css"]
html_css_files = ["docs_style.css"]
html_extra_path = ["made/pages"]
exclude_patterns = ["made/pages", "tutorials"]
autodoc_typehints = "none"
napoleon_attr_annotations = False
autodoc_member_order = "bysource"
napoleon_use_rtype = False
napoleon_use_ivar = True
nitpicky = False
default_role = "code"

make_recipes(HERE / "made" / "recipes.md")
make_gallery(HERE / "made")
make_tutorials(HERE / "made" / "tutorials")
make_commands(HERE / "made" / "commands.md")

PICTURE = re.compile(r"!\[([^\]]*)\]\((\S+)(\.png|\.webp)\)")


def both_pictures(app, name, text):
    """Show NAME_dark.png (or .webp), where it exists, instead of NAME.png on dark pages."""
    folder = (HERE / name).parent

    def both(found):
        if not (folder / f"{found[2]}_dark{found[3]}").is_file():
            return found[0]
        return f"{found[0]}{{.only-light}} ![{found[1]}]({found[2]}_dark{found[3]}){{.only-dark}}"

    text[0] = PICTURE.sub(both, text[0])


ACCESS = {
    'class="caption" role="heading">': 'class="caption" role="heading" aria-level="2">',
    '<div class="highlight"><pre>': '<div class="highlight"><pre tabindex="0">',
    'class="table-wrapper colwidths-auto docutils container"': 'class="table-wrapper docutils container" tabindex="0"',
    '<div id="search-results"></div>': '<h1>Search</h1>\n<div id="search-results"></div>',
    '<aside class="sidebar-drawer">': '<aside class="sidebar-drawer" aria-label="All pages">',
    '<aside class="toc-drawer">': '<aside class="toc-drawer" aria-label="This page">',
}
"""What the theme's pages lack for keyboards and screen readers, as axe-core 4 finds it: listings and
tables that scroll."""


def make_accessible(app, problem):
    """Complete every page that was written."""
    for page in Path(app.outdir).rglob("*.html") if problem is None else ():
        text = page.read_text(encoding="utf-8")
        if 'class="sidebar-drawer"' in text:  # not a page of a body
            for old, new in ACCESS.items():
                text = text.replace(old, new)
            page.write_text(text, encoding="utf-8")


def setup(app):
    """Let pages have pictures for light and dark, and complete them for keyboards."""
    app.connect("source-read", both_pictures)
    app.connect("build-finished", make_accessible)
