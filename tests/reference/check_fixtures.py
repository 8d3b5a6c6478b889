"""Volumes and Booleans of the fixture pairs by manifold3d, as JSON on standard output.

Usage: check_fixtures.py FOLDER

Reads every NAME_initial.obj and NAME_target.obj in FOLDER with a reader of its own, so that
nothing is shared with what is being checked. Volumes are mm³:

    {"pairs": [{"name", "initial", "target", "common", "removed", "added", "reuse_ideal"}, …]}

where common = M ∩ M*, removed = M − M*, added = M* − M and reuse_ideal = R_V = common / target.
Exits 1, naming the file, when a mesh is no closed, oriented manifold or a pair is not complete.
"""

import json
import sys
from pathlib import Path

import numpy as np
from manifold3d import Error, Manifold, Mesh64


def read_obj(path):
    """Corners (n × 3) and triangles (m × 3) of an OBJ file with plain `v` and triangular `f` lines."""
    corners, triangles = [], []
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if words[0] == "v" and len(words) == 4:
            corners.append([float(w) for w in words[1:]])
        elif words[0] == "f" and len(words) == 4:
            triangles.append([int(w) - 1 for w in words[1:]])
        else:
            raise SystemExit(f"{path}:{number}: expected `v x y z` or `f a b c`, found {line!r}")
    return np.array(corners, dtype=np.float64), np.array(triangles, dtype=np.uint64)


def load(path):
    solid = Manifold(Mesh64(*read_obj(path)))
    if solid.status() != Error.NoError or solid.is_empty():
        raise SystemExit(f"{path}: not a closed, oriented manifold ({solid.status()})")
    return solid


def check(folder, name):
    initial = load(folder / f"{name}_initial.obj")
    target = load(folder / f"{name}_target.obj")
    common = (initial ^ target).volume()
    return {
        "name": name,
        "initial": initial.volume(),
        "target": target.volume(),
        "common": common,
        "removed": (initial - target).volume(),
        "added": (target - initial).volume(),
        "reuse_ideal": common / target.volume(),
    }


def main():
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    folder = Path(sys.argv[1])
    names = {
        role: {p.name.removesuffix(f"_{role}.obj") for p in folder.glob(f"*_{role}.obj")}
        for role in ("initial", "target")
    }
    if lonely := names["initial"] ^ names["target"]:
        raise SystemExit(f"{folder}: one half of the pair is missing for {sorted(lonely)}")
    if not names["target"]:
        raise SystemExit(f"{folder}: no pairs NAME_initial.obj, NAME_target.obj")
    json.dump({"pairs": [check(folder, n) for n in sorted(names["target"])]}, sys.stdout, indent=1)


if __name__ == "__main__":
    main()
