"""Process of a contender: ``python -m benchmarks.worker NAME``.

The process reads one order per line from standard input (a JSON object with the folder of the problem and the
accuracy).  It answers with one line: seconds of setup and solve and the iterations, or an error.  It writes the
solution ``x`` into the folder.  A separate process can be ended after a time limit, and can use another Python.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.peers import PEERS, Matrix

Order = dict[str, Any]
Reply = dict[str, Any]


def read_matrix(folder: Path) -> Matrix:
    """Return the matrix that `benchmarks.contest` wrote into a folder."""
    return Matrix(*(np.load(folder / f"{part}.npy") for part in ("indptr", "indices", "data")))


def peer_job(name: str, folder: Path) -> Callable[[Order], Reply]:
    """Return a peer with a prepared problem."""
    setup, rhs = PEERS[name].prepare(read_matrix(folder)), np.load(folder / "rhs.npy")

    def run(order: Order) -> Reply:
        start = time.perf_counter()
        solve = setup()
        ready = time.perf_counter()
        x, iterations = solve(rhs, order["rtol"])
        done = time.perf_counter()
        np.save(folder / f"{name}.npy", x)
        return {"seconds": {"setup": ready - start, "solve": done - ready}, "iterations": iterations}

    return run


def own_job(folder: Path) -> Callable[[Order], Reply]:
    """Return resgrid with a prepared problem."""
    from benchmarks.ours import Resgrid
    from benchmarks.problems import Problem

    ready = Resgrid(Problem(**json.loads((folder / "problem.json").read_text())))
    nodes = np.load(folder / "nodes.npy")

    def run(order: Order) -> Reply:
        answer = ready.run(order.get("accuracy", "normwise"), order["rtol"])
        np.save(folder / "resgrid.npy", answer.voltage[nodes])
        return {"seconds": dict(answer.seconds), "iterations": answer.iterations, "method": answer.method}

    return run


def serve(name: str, orders: Any, replies: Any) -> None:
    """Answer orders until the end of the input."""
    folder, job = None, None
    for line in orders:
        order = json.loads(line)
        try:
            if folder != order["folder"]:
                job = None
                gc.collect()
                folder = order["folder"]
                job = own_job(Path(folder)) if name == "resgrid" else peer_job(name, Path(folder))
            reply = {} if order.get("prepare") or job is None else job(order)
        except Exception as error:  # every exception of a peer is its result
            folder, reply = None, {"failure": f"{type(error).__name__}: {error}"}
        gc.collect()
        replies.write(json.dumps(reply) + "\n")
        replies.flush()


def main() -> None:
    """Serve on standard input and output; redirect the output of libraries to standard error."""
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    serve(sys.argv[1], sys.stdin, replies)


if __name__ == "__main__":
    main()
