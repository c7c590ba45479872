"""What the cells of a page look like: where they run, how their output is joined, and what a picture is called."""

import os
import tempfile
from pathlib import Path

from docutils import nodes
from myst_nb.core import render

MAGIC = "%%bash -e\n"
STARTUP = """
c.InteractiveShellApp.exec_lines = [
    "%matplotlib inline",
    "import os; os.symlink(os.environ['PROJECT'] + '/examples', 'examples')",
]
"""


def run_beside_the_examples():
    """Let kernels begin with pictures shown, and with `examples/` in their folder, as in a clone of the project."""
    folder = Path(tempfile.mkdtemp(prefix="resgrid-docs-"))
    profile = folder / "profile_default"
    profile.mkdir()
    (profile / "ipython_kernel_config.py").write_text(STARTUP)
    os.environ["IPYTHONDIR"] = str(folder)


def joined(outputs):
    """Merge the pieces of each stream as they came; myst-nb would end a line after every hundred characters."""
    merged, streams = [], {}
    for output in outputs:
        name = output.get("name") if output["output_type"] == "stream" else None
        if name in streams:
            streams[name]["text"] += output["text"]
            continue
        merged.append(output)
        if name:
            streams[name] = output
    return merged


def name_pictures(_app, doctree):
    """Commands are shown as one types them, and a picture is called by the sentence before it."""
    for block in doctree.findall(nodes.literal_block):
        if block.astext().startswith(MAGIC):
            text = block.astext().removeprefix(MAGIC)
            block.replace_self(nodes.literal_block(text, text, language="bash"))
    heading, sentence = "", ""
    for node in doctree.findall():
        if isinstance(node, nodes.title):
            heading, sentence = node.astext(), ""
        elif isinstance(node, nodes.paragraph):
            sentence = node.astext().replace("\n", " ").split(". ")[0].rstrip(".:")
        elif isinstance(node, nodes.image) and not node.get("alt"):
            node["alt"] = f"{heading}: {sentence}".removesuffix(": ")


def setup(app):
    """Take the place of myst-nb's own joining, and look at every page that was read."""
    run_beside_the_examples()
    render.coalesce_streams = joined
    app.connect("doctree-read", name_pictures)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
