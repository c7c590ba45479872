"""Optional engine for large decks: the npm package ``eecircuit-engine``, ngspice as WebAssembly with KLU.

KLU orders sparse matrices well: 256 x 256 cells take seconds instead of the minutes of ngspice 39.  The package is not
part of resgrid; install it with ``npm install eecircuit-engine`` in the working folder or in a folder of ``NODE_PATH``.
"""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

from resgrid._internal.files import temporary_folder
from resgrid.errors import ToolMissingError
from resgrid.spice.run.ngspice import (
    RAW,
    SimulatorRun,
    find_program,
    refuse_commands,
    result_in,
    run_quietly,
    version_in,
)

NODE_VARIABLE, MODULE_VARIABLE = "RESGRID_NODE", "RESGRID_EECIRCUIT"
PACKAGE = "eecircuit-engine"
_INSTALL = (
    f"Node ({{name}}), which runs the engine {PACKAGE}, is not installed: 'sudo apt-get install nodejs npm' (Debian, "
    f"Ubuntu), 'brew install node' (macOS), or set {NODE_VARIABLE} to the program"
)
_SCRIPT = Path(__file__).with_name("eecircuit.mjs")
_END = re.compile(rb"^[ \t]*\.end[ \t\r]*$.*", re.IGNORECASE | re.MULTILINE | re.DOTALL)


def simulate_eecircuit(
    data: bytes, *, source: str = "deck", timeout: float = 600.0, direct: bool = False
) -> SimulatorRun:
    """Compute the operating point of a deck's content with ``eecircuit-engine`` and return the result.

    `data`: content of the deck; `source`: name of the deck in messages; `timeout`: longest run, in seconds; `direct`:
    whether the deck contains an analysis statement (if not, ``.op`` is added).  Raises ToolMissingError if the engine
    is not installed, BudgetError after the timeout, and InputError for a deck that could run commands or read files:
    ``.control``, ``.exec``, ``.csparam``, ``.include``, ``.lib``, and ``.model`` and ``.func`` unless `direct`.
    """
    node, module = find_program(NODE_VARIABLE, "node", _INSTALL), find_module()
    refuse_commands(data, source, models=direct)
    with temporary_folder() as folder:
        analysis = b"" if direct else b"\n.options klu\n.op"
        (folder / "deck.cir").write_bytes(_END.sub(b"", data) + analysis + b"\n.end\n")
        words = [node, str(_SCRIPT), str(module), "deck.cir", RAW]
        status = run_quietly(words, folder, timeout, source, PACKAGE)
        return result_in(folder, PACKAGE, version_in(folder), status)


def find_module() -> Path:
    """Return the path of the engine's JavaScript module; raise ToolMissingError if its package is not installed."""
    for folder in _folders():
        manifest = folder / "package.json"
        try:
            content = json.loads(manifest.read_text(encoding="utf-8"))
            module = folder / str(content["module"])
        except (OSError, ValueError, KeyError, TypeError):
            continue
        if module.is_file():
            return module.resolve()
    raise ToolMissingError(
        f"the engine {PACKAGE} is not installed: run 'npm install {PACKAGE}' in this folder, or set {MODULE_VARIABLE} "
        "to its folder, or add the folder above it to NODE_PATH"
    )


def _folders() -> Iterator[Path]:
    """Yield the folders in which the npm package may be installed, in the order of precedence."""
    named = os.environ.get(MODULE_VARIABLE)
    if named:
        yield Path(named)
        return
    for entry in os.environ.get("NODE_PATH", "").split(os.pathsep):
        if entry:
            yield Path(entry) / PACKAGE
    here = Path.cwd()
    for folder in (here, *here.parents):
        yield folder / "node_modules" / PACKAGE
    node = shutil.which(os.environ.get(NODE_VARIABLE) or "node")
    if node is not None:
        yield Path(node).resolve().parents[1] / "lib" / "node_modules" / PACKAGE
