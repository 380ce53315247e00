"""How the documentation is built: ``python -m sphinx -W --keep-going -b html .github/docs out/docs`` from the root.

Sphinx, because the docstrings of the package are reStructuredText with formulas and cross references, which it renders
and checks; the other pages are Markdown.
"""

import os
import re
import runpy
from pathlib import Path

import latex2mathml.converter
from docutils import nodes

import modalax  # loads nothing of JAX yet

HERE = Path(__file__).parent
os.environ.setdefault("JAX_PLATFORMS", "cpu")
(HERE / "causes.md").write_text(runpy.run_path(str(HERE / "causes_table.py"))["page"](), encoding="utf-8")

project, author, release = "modalax", "The modalax authors", modalax.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_math_renderer = "mathml"
html_static_path, html_css_files = ["_static"], ["wide.css"]
html_title = f"modalax {release}"
html_show_copyright = False
myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
autodoc_default_options = {"members": True, "show-inheritance": True}
napoleon_google_docstring = False
napoleon_use_ivar = True


def plain_types(app, what, name, obj, options, lines):
    """Attributes that share a line stay together, and the star of a shape such as "*batch n" begins no emphasis."""
    for k, line in enumerate(lines):
        if line.startswith(":vartype"):
            lines[k] = short_types(line).replace("*", r"\*")
        elif line.startswith(":ivar"):
            head, mark, rest = line[1:].partition(":")
            lines[k] = ":" + head.replace(", ", ",") + mark + rest


def plain_signature(app, what, name, obj, options, signature, returned):
    """The signature with the types' short names."""
    return short_types(signature), short_types(returned)


def short_types(text):
    """Names of types as they are imported."""
    return text and text.replace("jaxlib._jax.", "").replace("jaxtyping.", "")


def plain_annotations(app, domain, kind, content):
    """Types of attributes and properties with their short names."""
    for text in list(content.parent.findall(nodes.Text)):
        if "jaxlib._jax." in text and not isinstance(text.parent, nodes.literal):
            text.parent.replace(text, nodes.Text(short_types(str(text))))


def formula(self, node):
    """A formula as MathML, which browsers draw by themselves: no program, and no network, is needed to read it."""
    block = isinstance(node, nodes.math_block)
    text = latex2mathml.converter.convert(node.astext().strip(), display="block" if block else "inline")
    if unknown := re.search(r"<m[ito]>(\\[a-zA-Z]+)", text):
        raise SyntaxError(f"{node.source}, line {node.line}: {node.astext()!r}: no MathML for {unknown[1]}")
    self.body.append(f'<div class="math">{text}</div>' if block else text)
    raise nodes.SkipNode


def setup(app):
    """Called by Sphinx."""
    app.add_html_math_renderer("mathml", (formula, None), (formula, None))
    app.connect("autodoc-process-docstring", plain_types, priority=900)
    app.connect("autodoc-process-signature", plain_signature)
    app.connect("object-description-transform", plain_annotations)
