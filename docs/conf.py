"""Configuration of the documentation: ``sphinx-build -W docs build/docs``."""

import os
import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_ext"))

from smarttouch.base import __version__  # noqa: E402, sys.path is set above for the extensions

project = "SmartTouch"
author = "The SmartTouch developers"
copyright = "The SmartTouch developers"
version = release = __version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "command_line",
]
exclude_patterns = ["_templates", "_ext"]
templates_path = ["_templates"]
default_role = "py:obj"

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 3

autosummary_generate = True
autodoc_typehints = "none"  # numpydoc sections state the types, with units
numpydoc_show_class_members = False

html_theme = "pydata_sphinx_theme"
html_title = "SmartTouch"
html_static_path = ["_static"]
html_css_files = ["smarttouch.css"]
html_theme_options = {
    "navbar_align": "left",
    "header_links_before_dropdown": 8,
    "show_toc_level": 2,
    "footer_start": ["copyright"],
    "footer_end": [],
}
html_sidebars = {"index": []}
html_show_sourcelink = False

copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

# Examples cache the kernels that they design in build/, not in the user's cache folder.
os.environ.setdefault("XDG_CACHE_HOME", str(HERE.parent / "build" / "cache"))

sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "gallery_order.position",
    "minigallery_sort_order": "gallery_order.position",
    "nested_sections": False,
    "abort_on_example_error": True,
    "capture_repr": (),
    "doc_module": ("smarttouch",),
    "backreferences_dir": "gallery/uses",
    "matplotlib_animations": False,
    "min_reported_time": 3600,
    "show_memory": False,
    "show_signature": False,
    "remove_config_comments": True,
    "default_thumb_file": str(HERE / "pictures" / "kernel.png"),
}
