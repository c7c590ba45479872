"""Line numbers of TOML keys, compared with the positions of their text and with tomllib.

Tests internals: `resgrid.scene.toml_lines`.
"""

import tomllib

from hypothesis import given, strategies as st

from resgrid.scene.toml_lines import key_lines, line_of

TEXT = '''title = "a # b [x]"
"quoted key" = 'lit \\'
dotted.deep . key = 1   # comment with = and [
many = [
  1,   # one
  [2,
   3],
  { a = 4,
    b = "}" } , # inline
]
text = """
[not.a.table]
key = 'no' \\"""
"""
after = """x"""""
[table]
x = 2000-01-01T00:00:00
[table.sub]
y = -inf
[[list]]
z = 1
[[list]]
z = { p.q = 2, r = [ ] }
[list.inner]
w = true
[[list.deep]]
v = 1
[[list.deep]]
v = 2
'''.replace("{ a = 4,\n    b", "{ a = 4, b").replace("[not.a", "[not.a")


def numbered(path):
    return line_of(key_lines(TEXT), path)


def test_the_example_document_is_valid_toml():
    tomllib.loads(TEXT)


def test_every_kind_of_key_has_its_line_number():
    lines = TEXT.split("\n")

    def at(start):
        return next(i for i, line in enumerate(lines, 1) if line.startswith(start))

    assert numbered(("title",)) == 1
    assert numbered(("quoted key",)) == 2
    assert numbered(("dotted", "deep", "key")) == numbered(("dotted",)) == 3
    assert numbered(("many", 0)) == 5
    assert numbered(("many", 1, 1)) == 7
    assert numbered(("many", 2, "b")) == 8
    assert numbered(("after",)) == at("after")
    assert numbered(("table", "x")) == at("x =")
    assert numbered(("table", "sub", "y")) == at("y =")
    assert numbered(("list", 0, "z")) == at("z = 1")
    assert numbered(("list", 1, "z", "p", "q")) == at("z = {")
    assert numbered(("list", 1, "inner", "w")) == at("w =")
    assert numbered(("list", 1, "deep", 1, "v")) == at("v = 2")


def test_missing_keys_have_the_line_of_the_enclosing_table():
    assert numbered(("table", "missing")) == TEXT.split("\n").index("[table]") + 1
    assert numbered(("list", 0, "missing", 3)) == TEXT.split("\n").index("[[list]]") + 1
    assert numbered(("nowhere",)) is None


@given(st.recursive(st.integers(0, 9), lambda inner: st.lists(inner, max_size=4), max_leaves=20))
def test_every_element_of_nested_lists_has_its_line_number(value):
    def write(node):
        return "[\n" + "".join(write(entry) + ",\n" for entry in node) + "]" if isinstance(node, list) else str(node)

    text = f"key = {write(value)}\n"
    assert tomllib.loads(text)["key"] == value
    found = key_lines(text)

    def check(node, path):
        assert path in found
        if isinstance(node, list):
            for number, entry in enumerate(node):
                check(entry, (*path, number))
        else:
            assert text.split("\n")[found[path] - 1].removeprefix("key = ").rstrip(",") == str(node)

    check(value, ("key",))
