"""Whether compiled loops have to be made for this machine first, which takes a while once."""

from __future__ import annotations

import os
from pathlib import Path

import resgrid

NOTICE = "the first solution on this machine also compiles its loops: half a minute, once"

_INDEX = "row_kernels.conductances_by_row*.nbi"


def is_first_run() -> bool:
    """Whether no compiled loops are kept yet, where numba keeps them."""
    kept = os.environ.get("NUMBA_CACHE_DIR")
    if kept:
        return not any(Path(kept).glob(f"*/{_INDEX}"))
    return not any((Path(resgrid.__file__).parent / "nodal" / "__pycache__").glob(_INDEX))
