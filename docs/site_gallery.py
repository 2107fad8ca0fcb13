"""The gallery: every sample before and after, with the command that made it."""

from __future__ import annotations

import json
import tempfile
from contextlib import chdir
from pathlib import Path

from site_pages import shrink

from meshdeform_cli.main import run

SIZES = {"splitter-plate": "8", "airfoil": "101", "square": "61", "beam": "40", "hemisphere": "12", "wing": "12"}
"""Sizes that a picture can show and a minute can compute; other samples have their own."""

VIEWS: dict[str, tuple[str, ...]] = {
    "airfoil": ("--zoom=-0.8,0.8,-0.7,0.7",),
    "splitter-plate": ("--plane", "k=1"),
    "valve": ("--plane", "k=1"),
    "beam": ("--zoom=-2,2,-1,1.2",),
    "cascade": ("--zoom=-4,8,-3,3",),
    "hemisphere": ("--select", "membrane", "--view", "iso"),
    "wing": ("--select", "wing", "--view", "iso"),
}
MOTIONS: dict[str, tuple[str, ...]] = {
    "hemisphere": ("--time", "2.5e-4"),
    "valve": ("--time", "0.1"),
    "workshop-cylinder": ("--time", "2"),
}


def gallery_page(folder: Path, quick: bool) -> str:
    """The page; its pictures are written into ``folder``."""
    from meshdeform_samples import SAMPLES

    head = "# Gallery\n\nThe samples, undeformed and deformed, coloured by f_skew (1 orthogonal, 0 invalid)."
    if quick:
        return f"{head}\n\nThis site was built without its pictures (`make docs` draws them).\n"
    folder.mkdir(parents=True, exist_ok=True)
    return "\n\n".join([head, *(_entry(name, folder) for name in SAMPLES)]) + "\n"


def _entry(name: str, folder: Path) -> str:
    sample = ["sample", name, "-o", name, *(("--size", SIZES[name]) if name in SIZES else ())]
    deform = ["deform", f"{name}/grid.cgns", "-c", f"{name}/case.toml", *MOTIONS.get(name, ()),
              "-o", f"{name}/deformed.cgns"]  # fmt: skip
    with tempfile.TemporaryDirectory() as place, chdir(place):
        case = Path(name)
        _call(*sample)
        _call(*deform, "--report", str(case / "r.json"), "-q")
        for grid, title in (("grid", "undeformed"), ("deformed", "deformed")):
            picture = case / f"{grid}.png"
            _call(
                "plot",
                str(case / f"{grid}.cgns"),
                "-o",
                str(picture),
                *VIEWS.get(name, ()),
                "--range",
                "0,1",
                "--title",
                title,
            )
            shrink(picture, folder.resolve() / f"{name}-{grid}.png", 800)
        report = json.loads((case / "r.json").read_text())
    skew = report["quality"]["after"]["f_skew"]
    lines = "\n".join(f"meshdeform {' '.join(command)}" for command in (sample, deform))
    images = "\n".join(
        f'<figure markdown="span">![{name}, {grid}](gallery/{name}-{grid}.png)</figure>'
        for grid in ("grid", "deformed")
    )
    return (
        f'## {name}\n\n<div class="gallery" markdown>\n{images}\n</div>\n\n'
        f"{report['grid']['nodes']:,} nodes; f_skew after: harmonic mean {skew['harmonic_mean']:.3f}, "
        f"minimum {skew['min']:.3f}."
        f"\n\n```sh\n{lines}\n```"
    )


def _call(*arguments: str) -> None:
    if code := run(list(arguments)):
        raise SystemExit(f"meshdeform {' '.join(arguments)} ended with {code}")
