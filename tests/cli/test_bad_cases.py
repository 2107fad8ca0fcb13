"""Wrong case files: each is refused with one message that names what is wrong, and nothing is written."""

from __future__ import annotations

import pytest

HEAD = '[[boundary]]\nname = "body"\nselect = ["*"]\nwhere = "abs(x) < 0.51 and abs(y) < 0.51"\n'
MOVING = HEAD + 'kind = "moving"\n'
SHIFT = MOVING + "motion = [{ translate = [0.1, 0, 0] }]\n"


def body(line: str) -> str:
    """The moving body with its motion replaced by ``line``."""
    return MOVING + line + "\n"


def moved(formula: str) -> str:
    return body(f"motion = [{{ displace = [{formula!r}, 0, 0] }}]")


# id: (case file, fragments of the message)
WRONG = {
    # not TOML
    "syntax": ("[method\nname = 'tfi'", ("not a TOML file", "line 1")),
    "endless-integer": ("[constants]\nL = " + "9" * 5000, ("64 bits", "1e30")),
    "nested-too-deeply": ("a = " + "[" * 3000 + "]" * 3000, ("not a TOML file", "nested too deeply")),
    # unknown keys at every level
    "key-top": ("[metod]\nname = 'tfi'", ("unknown key 'metod'", "did you mean 'method'")),
    "key-grid": ("[grid]\nboundary_fil = 'a.nmf'", ("[grid]", "boundary_fil", "did you mean 'boundary_file'")),
    "key-boundary": (SHIFT + "selct = ['a']", ("boundary 'body'", "selct", "did you mean 'select'")),
    "key-motion": (body("motion = [{ translat = [0, 0, 0] }]"), ("motion step 1", "did you mean 'translate'")),
    "key-method": ("[method]\nnam = 'tfi'\n" + SHIFT, ("[method]", "nam", "did you mean 'name'")),
    "key-of-a-part": ("[method]\nalpha = 0.1\n" + SHIFT, ("unknown key 'alpha'", "did you mean 'method.idw.alpha'?")),
    "key-nothing-near": ("[zzz]\n", ("unknown key 'zzz'", "known are grid, constants, boundary, method")),
    # wrong types at every level
    "type-constant": ("[constants]\nL = 'five'", ("constants.L", "finite number", "'five'")),
    "type-select": (SHIFT.replace('["*"]', "7"), ("boundary 'body'", "select = 7", "list of names")),
    "type-where": (SHIFT.replace('"abs(x) < 0.51 and abs(y) < 0.51"', "[1]"), ("where", "[1]", "formula")),
    "type-kind": (SHIFT.replace('"moving"', "['moving']"), ("boundary 'body'", "kind = ['moving']", "fixed")),
    "type-motion": (body("motion = 5"), ("motion", "list of tables")),
    "type-translate": (body("motion = [{ translate = 0.1 }]"), ("translate", "three values", "0.1")),
    "type-rotate": (body("motion = [{ rotate = 30 }]"), ("rotate = 30", "angle")),
    "type-angle": (body("motion = [{ rotate = { angle = true } }]"), ("angle = true", "number or a formula in quotes")),
    "type-file": (body("motion = [{ file = 5 }]"), ("motion step 1", "file name, found 5")),
    "type-match": (
        body("motion = [{ file = 'table.csv', match = 5 }]"),
        ("motion step 1", "match = 5", "exact, nearest, interpolate"),
    ),
    # values out of range
    "value-tolerance": ("[grid]\ntolerance = 0.7", ("grid.tolerance", "0.7", "between 0 and 0.5")),
    "value-constant-nan": ("[constants]\nL = nan", ("constants.L", "finite", "nan")),
    "value-constant-minus-infinity": ("[constants]\nL = -inf", ("constants.L", "finite", "-inf")),
    "value-constant-t": ("[constants]\nt = 1", ("constants.t", "already has a meaning")),
    "value-kind": (SHIFT.replace('"moving"', '"movin"'), ("kind = 'movin'", "did you mean 'moving'")),
    "value-no-kind": ('[[boundary]]\nname = "a"', ("boundary 'a'", "has no kind", "moving, fixed")),
    "value-axis": (body("motion = [{ rotate = { angle = 5, axis = [0, 0, 0] } }]"), ("axis", "no direction")),
    "value-two-steps-in-one": (
        body("motion = [{ translate = [0, 0, 0], rotate = { angle = 1 } }]"),
        ("exactly one of",),
    ),
    "value-match-of-rotate": (body("motion = [{ translate = [0, 0, 0], match = 'exact' }]"), ("takes no match",)),
    "value-empty-step": (body("motion = [{}]"), ("motion step 1", "exactly one of")),
    "value-no-motion": (MOVING, ("boundary 'body'", "moves but has no motion")),
    "value-motion-of-fixed": (
        HEAD + "kind = 'fixed'\nmotion = [{ translate = [0, 0, 0] }]",
        ("boundary 'body'", "is fixed but has a motion"),
    ),
    "same-name-twice": (SHIFT + SHIFT, ("boundary", "names must differ", "body")),
    # formulas
    "formula-syntax": (moved("0.1*"), ("'0.1*'", "not a formula")),
    "formula-name": (moved("q*x"), ("unknown name 'q'", "known are")),
    "formula-function": (moved("sine(x)"), ("unknown function 'sine'", "did you mean 'sin")),
    "formula-arguments": (moved("atan2(x)"), ("atan2 takes 2 arguments, found 1",)),
    "formula-power": (moved("x^2"), ("not allowed", "powers are written **")),
    "formula-time-in-where": (SHIFT.replace("abs(x) < 0.51", "t < 1"), ("where", "unknown name 't'")),
    "formula-number-too-large": (moved("1" + "0" * 400), ("beyond the range",)),
    "formula-too-long": (moved("+".join(["x"] * 600)), ("1000",)),
    "formula-too-deep": (moved("(" * 400 + "x" + ")" * 400), ("not a formula",)),
    # formulas that reach for Python
    "python-attribute": (moved("x.__class__"), ("x.__class__", "not allowed")),
    "python-in-angle": (body("motion = [{ rotate = { angle = 'x.real' } }]"), ("x.real", "not allowed")),
    # selections
    "select-unknown": (SHIFT.replace('"*"]', '"wing"]'), ("'wing'", "no named patches", "block1.imin")),
    "select-shared": (SHIFT.replace('"*"]', '"block1.imax"]'), ("shared with other blocks", "meshdeform info")),
    "where-nothing": (SHIFT.replace("abs(x) < 0.51", "x > 99"), ("where", "not satisfied on any face", "x -2 to 2")),
    "where-nan": (SHIFT.replace("abs(x) < 0.51", "sqrt(-1) > 0"), ("where", "is not a number")),
    # motions that cannot be
    "nothing-moves": ('[[boundary]]\nname = "all"\nkind = "fixed"', ("no node moves", 'kind = "moving"')),
    "motion-nan": (moved("log(x)"), ("motion step 1", "at node block1", "check the formulas")),
    "moving-conflict": (
        SHIFT + SHIFT.replace('"body"', '"other"').replace("0.1", "0.2"),
        ("'body' and 'other' disagree", "shared node", "0.1", "0.2"),
    ),
    "periodic-one-side": (
        "[[boundary]]\nselect = ['block1.imin']\nkind = 'periodic'\n" + SHIFT,
        ("periodic", "one side, other side"),
    ),
    "periodic-no-match": (
        "[[boundary]]\nname = 'p'\nselect = ['block1.imin', 'block1.jmin']\nkind = 'periodic'\n" + SHIFT,
        ("'p'", "do not match"),
    ),
    # files
    "boundary-file-missing": ("[grid]\nboundary_file = 'no.nmf'\n" + SHIFT, ("no.nmf", "No such file")),
    "boundary-file-null": ('[grid]\nboundary_file = "a\\u0000b"\n' + SHIFT, ("boundary_file", "expected a file name")),
    "table-folder": (body("motion = [{ file = '.' }]"), ("is a folder",)),
    "table-is-case": (body("motion = [{ file = 'case.toml' }]"), ("case.toml", "not a displacement table")),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_case_is_refused(name, bench, call, snapshot):
    text, fragments = WRONG[name]
    (bench / "wrong.toml").write_text(text)
    before = snapshot(bench)
    result = call("deform", "grid.xyz", "-c", "wrong.toml", "-o", "out.xyz", "--report", "out.json")
    assert snapshot(bench) == before
    assert result.code == 2
    assert result.out == ""
    assert result.error.startswith("meshdeform: error: ")
    assert result.error.count("\n") == 1
    missing = [fragment for fragment in fragments if fragment not in result.err]
    assert not missing, result.err
