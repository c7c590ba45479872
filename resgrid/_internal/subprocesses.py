"""Termination of an outside program together with its child processes."""

from __future__ import annotations

import os
import signal
import subprocess


def kill_session(process: subprocess.Popen[bytes] | subprocess.Popen[str]) -> None:
    """Kill a process and its child processes; do nothing if the process has ended.

    `process`: started with ``start_new_session=True``. On Windows, which has no sessions, the child processes are not
    killed.
    """
    if process.poll() is not None:
        return
    if hasattr(os, "killpg"):
        os.killpg(process.pid, signal.SIGKILL)
    else:
        process.kill()
    process.wait()
