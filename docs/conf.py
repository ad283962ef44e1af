"""Configuration of the documentation site. `make docs` builds it, offline and without a warning."""

import os
import sys
from pathlib import Path

DOCS = Path(__file__).resolve().parent
sys.path[:0] = [str(DOCS.parent), str(DOCS / "_ext")]

import torch_geometric_tactile  # noqa: E402

REPOSITORY = "https://github.com/torch-geometric-tactile/torch_geometric_tactile"

project = "torch_geometric_tactile"
author = "the authors of torch_geometric_tactile"
copyright = author
version = release = torch_geometric_tactile.__version__
html_title = project
language = "en"

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.intersphinx",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "myst_nb",
    "sphinx_copybutton",
    "sphinx_design",
    "api_pages",
    "command_pages",
    "inventories",
    "mathml",
    "repository_links",
    "tutorial_pages",
    "wide_tables",
]

exclude_patterns = ["build", "inventories", "_ext", "_extra", "_templates"]
templates_path = ["_templates"]
repository_url = REPOSITORY
# The tutorials with their outputs, as committed; no page runs one. "0" leaves them out.
tutorial_folder = "../tutorials/notebooks"
if os.environ.get("TACTILE_DOCS_TUTORIALS") == "0":
    tutorial_folder = ""

# -- Docstrings --------------------------------------------------------------------------------
autosummary_generate = True
autosummary_ignore_module_all = False
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
python_maximum_signature_line_length = 88
python_use_unqualified_type_names = True
add_module_names = False
toc_object_entries_show_parents = "hide"
napoleon_numpy_docstring = False
napoleon_custom_sections = ["Shapes"]
napoleon_use_ivar = True  # "Attributes" as a list; members that are properties have their own entry
napoleon_use_rtype = False
viewcode_follow_imported_members = True

# -- Markdown and notebooks --------------------------------------------------------------------
nb_execution_mode = "off"
nb_ipywidgets_js = {}  # from a foreign host otherwise; our tutorials have no widgets
myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath", "html_image"]
myst_heading_anchors = 4
myst_links_external_new_tab = False

# -- Links -------------------------------------------------------------------------------------
_ONLINE = os.environ.get("TACTILE_DOCS_ONLINE") == "1"
_HOMES = {
    "python": "https://docs.python.org/3/",
    "numpy": "https://numpy.org/doc/stable/",
    "torch": "https://docs.pytorch.org/docs/stable/",
    "torch_geometric": "https://pytorch-geometric.readthedocs.io/en/latest/",
    "matplotlib": "https://matplotlib.org/stable/",
    "lightning": "https://lightning.ai/docs/pytorch/stable/",
    "sklearn": "https://scikit-learn.org/stable/",
}
online_inventories = _ONLINE
intersphinx_mapping = {
    name: (home, None if _ONLINE else str(DOCS / "generated" / f"{name}.inv"))
    for name, home in _HOMES.items()
}
linkcheck_timeout = 20
linkcheck_anchors = False  # pages that draw their anchors with scripts are reported as broken

# -- The pages ---------------------------------------------------------------------------------
smartquotes_action = "qe"  # no dashes: an option such as --folds keeps its hyphens
html_theme = "pydata_sphinx_theme"
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_extra_path = ["_extra"]  # pages at addresses that have moved
html_css_files = ["custom.css"]
html_logo = html_favicon = "_static/logo.svg"
html_copy_source = html_show_sourcelink = False
html_last_updated_fmt = None
html_context = {"default_mode": "auto"}
html_sidebars = {"index": []}
html_theme_options = {
    "logo": {"text": project},
    "github_url": REPOSITORY,
    "header_links_before_dropdown": 9,
    "show_prev_next": True,
    "show_nav_level": 1,
    "navigation_depth": 2,
    "show_toc_level": 2,
    "collapse_navigation": True,
    "navigation_with_keys": False,
    "back_to_top_button": True,
    "footer_start": ["copyright"],
    "footer_end": [],
    "pygments_light_style": "a11y-high-contrast-light",
    "pygments_dark_style": "a11y-high-contrast-dark",
}
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
