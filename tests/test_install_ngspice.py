"""The installation script of ngspice, run with substitutes for the system's programs."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]

INSTALLS = """echo "$@" >> {log}
case "$*" in *install*) echo "#!/bin/sh" > {bin}/ngspice; /bin/chmod +x {bin}/ngspice;; esac"""


def run_script(folder: Path, programs: dict[str, str], **environment: str) -> tuple[int, str, str]:
    """Exit status, messages and recorded installer calls, with only the given programs on PATH."""
    bin_, log = folder / "bin", folder / "log"
    bin_.mkdir()
    log.touch()
    for name, body in programs.items():
        (bin_ / name).write_text("#!/bin/sh\n" + body.replace("{log}", str(log)).replace("{bin}", str(bin_)) + "\n")
        (bin_ / name).chmod(0o755)
    run = subprocess.run(
        ["/bin/sh", PROJECT / "scripts" / "install_ngspice.sh"],
        env={"PATH": str(bin_), **environment},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    return run.returncode, run.stderr, log.read_text()


ENV = 'while case "$1" in *=*) true;; *) false;; esac; do shift; done; exec "$@"'
ROOT = {"id": "echo 0", "env": ENV, "apt-get": INSTALLS}
USER = {"id": "echo 1000", "env": ENV, "apt-get": INSTALLS}


@pytest.mark.parametrize(
    ("programs", "asked"),
    [
        ({"ngspice": "", **USER}, ""),
        (ROOT, "update -qq\ninstall -y -qq --no-install-recommends ngspice\n"),
        ({**ROOT, "sudo": "exit 1"}, "update -qq\ninstall -y -qq --no-install-recommends ngspice\n"),
        (
            {**USER, "sudo": 'shift; exec "$@"', "true": ""},
            "update -qq\ninstall -y -qq --no-install-recommends ngspice\n",
        ),
        ({"brew": INSTALLS}, "install ngspice\n"),
    ],
    ids=["present", "root", "root without sudo", "passwordless sudo", "brew"],
)
def test_ngspice_is_installed_by_the_available_installer(tmp_path: Path, programs: dict[str, str], asked: str) -> None:
    status, messages, log = run_script(tmp_path, programs)
    assert (status, messages) == (0, "")
    assert log == asked


@pytest.mark.parametrize(
    ("programs", "environment", "command"),
    [
        (USER, {}, "sudo apt-get update && sudo apt-get install -y ngspice"),
        ({**USER, "sudo": "exit 1"}, {}, "sudo apt-get update && sudo apt-get install -y ngspice"),
        ({**ROOT, "apt-get": "exit 100"}, {}, "sudo apt-get update && sudo apt-get install -y ngspice"),
        ({**ROOT, "apt-get": "exit 0"}, {}, "not on PATH"),
        ({"brew": "exit 1"}, {}, "brew install ngspice"),
        ({}, {}, "sudo dnf install ngspice"),
        (ROOT, {"RESGRID_NGSPICE": "/nowhere/ngspice"}, "correct or unset it"),
    ],
)
def test_a_failed_installation_prints_the_command_to_use(
    tmp_path: Path, programs: dict[str, str], environment: dict[str, str], command: str
) -> None:
    status, messages, _ = run_script(tmp_path, programs, **environment)
    assert status == 1
    assert command in messages


OF_VERSION = """echo "$@" >> {log}
case "$*" in *-t*) n=46;; *) n=39;; esac
case "$*" in *sourcelist=*update*) /bin/cat "${2#*=}" >> {log}; case "$4" in *=-) ;; *) exit 1;; esac;; esac
case "$*" in *install*) printf '#!/bin/sh\\necho "** ngspice-%s : Circuit"\\n' $n > {bin}/ngspice
/bin/chmod +x {bin}/ngspice;; esac"""
TOOLS = {name: f'exec /bin/{name} "$@"' for name in ("mktemp", "mkdir", "chmod", "rm")}


def test_another_version_is_installed_from_backports(tmp_path: Path) -> None:
    (tmp_path / "release").write_text("VERSION_CODENAME=bookworm\n")
    programs = {**ROOT, **TOOLS, "apt-get": OF_VERSION, "ngspice": "echo '** ngspice-39 : Circuit'"}
    environment = {"NGSPICE_VERSION": "46", "OS_RELEASE": str(tmp_path / "release"), "TMPDIR": str(tmp_path)}
    status, messages, log = run_script(tmp_path, programs, **environment)
    assert (status, messages) == (0, "")
    assert log.count("bookworm-backports main") == 1 and "-t bookworm-backports ngspice" in log
    assert {file.name for file in tmp_path.iterdir()} == {"bin", "log", "release"}


@pytest.mark.parametrize(("version", "status"), [("39", 0), ("46", 0), ("3", 1), ("45", 1)])
def test_the_status_depends_on_the_requested_version(tmp_path: Path, version: str, status: int) -> None:
    (tmp_path / "release").write_text("VERSION_CODENAME=bookworm\n")
    programs = {**ROOT, **TOOLS, "apt-get": OF_VERSION}
    environment = {"NGSPICE_VERSION": version, "OS_RELEASE": str(tmp_path / "release"), "TMPDIR": str(tmp_path)}
    found, messages, _ = run_script(tmp_path, programs, **environment)
    assert found == status
    assert (f"not version {version}" in messages) == bool(status)
