"""Execution of code cells: working folder, merged output, and alternative texts of pictures."""

import atexit
import os
import shutil
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


def configure_kernels():
    """Start kernels with inline pictures, in a folder with a link to `examples/`, as in a clone of the project."""
    folder = Path(tempfile.mkdtemp(prefix="resgrid-docs-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    profile = folder / "profile_default"
    profile.mkdir()
    (profile / "ipython_kernel_config.py").write_text(STARTUP)
    os.environ["IPYTHONDIR"] = str(folder)


def joined(outputs):
    """Return the outputs with the text of each stream merged; myst-nb breaks lines after a hundred characters."""
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
    """Remove the cell magic from shown commands, and use the sentence before a picture as its alternative text."""
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
    """Replace the merging of streams in myst-nb, and process every page after reading."""
    configure_kernels()
    render.coalesce_streams = joined
    app.connect("doctree-read", name_pictures)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
