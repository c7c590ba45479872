"""Help and completion: a verb's own options first, examples that parse, values that a shell completes.

Tests internals: `resgrid.cli`, `resgrid.cli.entry`.
"""

from __future__ import annotations

import shlex

import click
import pytest
from click.shell_completion import ShellComplete

from resgrid.cli import main
from resgrid.cli.entry import SUBCOMMANDS

COMMANDS = {verb: main.get_command(click.Context(main), verb) for verb in SUBCOMMANDS}
SCENE_VERBS = [verb for verb in SUBCOMMANDS if verb != "completion"]
SHARED = {
    "--boundary", "--drive", "--edge", "--resistance", "--goal", "--start", "--cells", "--robot-radius", "--k", "--set",
    "--threads", "--json", "--quiet", "--verbose",
}  # fmt: skip


@pytest.mark.parametrize("verb", SCENE_VERBS)
def test_every_verb_that_takes_a_scene_has_the_same_options_for_its_keys(verb):
    assert {name for parameter in COMMANDS[verb].params for name in parameter.opts} >= SHARED


@pytest.mark.parametrize("verb", SCENE_VERBS)
def test_help_shows_a_verb_s_own_options_first_in_groups(call, verb):
    text = call(verb, "--help").stdout
    titles = "Options:", "Output:", "Scene keys:", "Map options:", "Deck options:"
    places = [text.index(f"\n{title}\n") for title in titles if f"\n{title}\n" in text]
    assert places == sorted(places) and len(places) >= 4
    assert ("Deck options:" in text) == ("DECK" in text.splitlines()[0])
    assert text.index("Output:") < text.index("--json") < text.index("--boundary") < text.index("--format")
    for parameter in COMMANDS[verb].params:
        assert not isinstance(parameter, click.Option) or parameter.opts[-1] in text


@pytest.mark.parametrize("verb", SUBCOMMANDS)
def test_the_examples_of_help_are_command_lines(verb):
    command = COMMANDS[verb]
    assert command.examples and SUBCOMMANDS[verb]
    for example in command.examples:
        words = shlex.split(example.replace('eval "$(', "").replace(')"', "").split(" | ")[0])
        assert words[:2] == ["resgrid", verb]
        command.make_context(verb, words[2:])


@pytest.mark.parametrize(
    ("words", "begin", "expected"),
    [
        (["path", "--boundary"], "", {"dirichlet", "neumann", "wall"}),
        (["compile", "--dialect"], "x", {"xyce"}),
        (["control", "--settle"], "", {"chip", "jacobi", "sor"}),
        (["plot", "--what"], "s", {"space", "slices"}),
        (["info", "--unknown"], "f", {"free"}),
        (["path", "--set"], "ch", {"chip."}),
        (["path", "--set"], "chip.defects.short", {"chip.defects.short_density=", "chip.defects.short_resistance="}),
        (["path", "--set"], "chips.", set()),
        (["chip", "--executor"], "p", {"processes", "parsl:"}),
        (["completion"], "", {"bash", "zsh", "fish"}),
        ([], "con", {"convert", "control"}),
    ],
)
def test_values_are_completed(words, begin, expected):
    completion = ShellComplete(main, {}, "resgrid", "_RESGRID_COMPLETE")
    assert {item.value for item in completion.get_completions(words, begin)} == expected


def test_files_are_completed_by_the_shell():
    completion = ShellComplete(main, {}, "resgrid", "_RESGRID_COMPLETE")
    for words in (["run"], ["path", "-o"], ["check", "--deck"]):
        assert [item.type for item in completion.get_completions(words, "ma")] == ["file"]


def test_shipped_scenes_are_completed_beside_files(tmp_path, monkeypatch):
    completion = ShellComplete(main, {}, "resgrid", "_RESGRID_COMPLETE")
    monkeypatch.chdir(tmp_path)

    def completed(begin):
        return [item.value for item in completion.get_completions(["run"], begin)]

    assert completed("ro") == ["rooms"]
    assert {"lesson", "rooms", "voxels"} <= set(completed(""))
    (tmp_path / "robots").mkdir()
    (tmp_path / "room.toml").touch()
    assert completed("ro") == ["robots/", "room.toml", "rooms"]
    assert [item.type for item in completion.get_completions(["run"], "")] == ["file"]


@pytest.mark.parametrize("words", [("lesson.toml", "--k", "0.5"), ("rooms",), ("deck.cir",)])
def test_a_missing_command_is_named(call, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = call(*words)
    assert result.exit_code == 2
    assert f"resgrid run {shlex.join(words)}" in result.stderr


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_for_a_shell_is_printed(call, shell):
    result = call("completion", shell)
    assert result.exit_code == 0 and "_RESGRID_COMPLETE" in result.stdout and "resgrid" in result.stdout
    assert call("completion", "tcsh").exit_code == 2
