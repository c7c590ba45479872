"""Render formulas as MathML, which browsers display without scripts, fonts or other sites."""

from docutils import nodes
from latex2mathml.converter import convert


def inline(translator, node):
    """Write an inline formula."""
    translator.body.append(convert(node.astext(), display="inline"))
    raise nodes.SkipNode


def block(translator, node):
    """Write a displayed formula."""
    formula = convert(node.astext(), display="block")
    translator.body += [translator.starttag(node, "div", CLASS="math"), formula, "</div>"]
    raise nodes.SkipNode


def setup(app):
    """Register the renderer."""
    app.add_html_math_renderer("mathml", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
