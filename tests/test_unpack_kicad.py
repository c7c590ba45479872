"""The script that unpacks kicad-cli, run with substitutes for the system's programs."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]
TOOLS = ("cat", "chmod", "dirname", "env", "id", "mkdir", "mktemp", "mv", "readlink", "rm", "sh")

APT = """echo "$@" >> {log}
for word in "$@"; do case $word in Dir::Cache=*) cache=${word#*=};; Dir::Etc::sourcelist=*) list=${word#*=};; esac; done
case "$*" in *update*) cat "$list" >> {log};; *--download-only*) for name in kicad_9 libgit2_1 ngspice_46
do echo "$name" > "$cache/archives/$name.deb"; done;; esac"""
UNPACK = """[ "$1" = --extract ] || exit 1
read name < "$2"; echo "unpacked $name" >> {log}
mkdir -p "$3/usr/bin" "$3/usr/lib/x86_64-linux-gnu"
printf '#!/bin/sh\\necho 9.0.8 $LD_LIBRARY_PATH\\n' > "$3/usr/bin/kicad-cli"
chmod +x "$3/usr/bin/kicad-cli\""""


def run_script(
    folder: Path, programs: dict[str, str], release: str = "bookworm"
) -> tuple[subprocess.CompletedProcess[str], str]:
    """The finished script and the recorded calls, with only the given programs and a few basic ones on PATH."""
    bin_, log = folder / "bin", folder / "log"
    bin_.mkdir(exist_ok=True)
    log.touch()
    (folder / "release").write_text(f"VERSION_CODENAME={release}\n")
    for name in TOOLS:
        (bin_ / name).unlink(missing_ok=True)
        (bin_ / name).symlink_to(next(p for p in (Path("/bin") / name, Path("/usr/bin") / name) if p.exists()))
    for name, body in programs.items():
        (bin_ / name).write_text("#!/bin/sh\n" + body.replace("{log}", str(log)) + "\n")
        (bin_ / name).chmod(0o755)
    run = subprocess.run(
        ["/bin/sh", PROJECT / "scripts" / "unpack_kicad.sh", folder / "a b" / "kicad"],
        env={"PATH": str(bin_), "OS_RELEASE": str(folder / "release"), "TMPDIR": str(folder)},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    return run, log.read_text()


def test_kicad_is_unpacked_from_backports_without_ngspice(tmp_path: Path) -> None:
    run, log = run_script(tmp_path, {"apt-get": APT, "dpkg-deb": UNPACK})
    folder = tmp_path / "a b" / "kicad"
    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout.startswith("unpacked kicad-cli 9.0.8") and str(folder) in run.stdout
    assert "bookworm-backports main" in log and "-t bookworm-backports kicad" in log
    assert "unpacked kicad_9" in log and "unpacked libgit2_1" in log and "unpacked ngspice_46" not in log
    assert "update" not in log.split("sudo")[1:] and {p.name for p in tmp_path.iterdir()} == {
        "a b",
        "bin",
        "log",
        "release",
    }
    printed = subprocess.run([folder / "kicad-cli", "version"], capture_output=True, text=True, check=True).stdout
    assert printed.split(maxsplit=1)[1].startswith(f"{folder}/usr/lib/x86_64-linux-gnu:")
    again, after = run_script(tmp_path, {"apt-get": "exit 1"})
    assert (again.returncode, again.stdout, after) == (0, "", log)


@pytest.mark.parametrize(
    ("programs", "release", "words"),
    [
        ({}, "bookworm", "This system is not Debian 12. Install KiCad 9 or newer"),
        ({"apt-get": APT}, "noble", "This system is not Debian 12."),
        ({"apt-get": "exit 1"}, "bookworm", "The backports of bookworm cannot be reached"),
        ({"apt-get": 'case "$*" in *update*) ;; *) exit 100;; esac'}, "bookworm", "Its packages cannot be downloaded"),
        ({"apt-get": APT, "dpkg-deb": "exit 2"}, "bookworm", "cannot be unpacked; is the disk full?"),
        ({"apt-get": APT, "dpkg-deb": UNPACK.replace("echo 9", "exit 1; echo 9")}, "bookworm", "does not start"),
    ],
)
def test_a_failure_gives_its_reason_and_leaves_no_program(
    tmp_path: Path, programs: dict[str, str], release: str, words: str
) -> None:  # fmt: skip
    run, _ = run_script(tmp_path, programs, release)
    assert run.returncode == 1 and words in run.stderr
    assert not (tmp_path / "a b" / "kicad" / "kicad-cli").exists()
