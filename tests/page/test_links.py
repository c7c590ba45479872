"""Links hold a whole scene, and the command line takes them."""

from __future__ import annotations

import base64
import json
import zlib

import numpy as np
import pytest
from support.cli import answer, call

from resgrid.errors import InputError
from resgrid.page.drawing import blank, drawing_of
from resgrid.scene.links import is_link, read_link


def link(document: object) -> str:
    packer = zlib.compressobj(wbits=-zlib.MAX_WBITS)
    content = packer.compress(json.dumps(document).encode()) + packer.flush()
    return f"http://127.0.0.1:8017/#s={base64.urlsafe_b64encode(content).decode().rstrip('=')}"


def test_a_link_is_its_scene():
    drawing = blank(12)
    address = link(drawing.document())
    assert is_link(address) and not is_link("http://127.0.0.1/") and not is_link("rooms.toml")
    np.testing.assert_array_equal(drawing_of(read_link(address)).cell, drawing.cell)


def test_the_command_line_takes_links(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    address = link(blank(12).document())
    assert answer("path", address)["paths"][0]["outcome"] == "reached"
    assert answer("path", address, "--k", "0.5")["paths"][0]["k"] == 0.5
    assert call("run", address, "--no-check").exit_code == 0
    assert (tmp_path / "out" / "scene" / "paths.csv").exists()


@pytest.mark.parametrize(
    "address",
    [link({"schema": 1})[:-9], "http://x/#s=@@", "http://x/#s=AAAA", link([1]), link({"map": {"file": "/etc/passwd"}})],
)
def test_a_damaged_link_says_so(address):
    with pytest.raises(InputError, match="link"):
        read_link(address)
