"""Drop-cutter heights by opencamlib, as JSON on standard output.

Usage: drop_cutter.py FOLDER

For three parts of FOLDER and six cutters, tips are dropped on a grid of irregular points over the
part's box. Heights are of the tip, mm; null where the cutter meets nothing:

    {"cases": [{"part", "ball", "diameter", "points": [[x, y, z or null], …]}, …]}
"""

import json
import sys
from pathlib import Path

import opencamlib as ocl
from check_fixtures import read_obj

PARTS = ["bearing_target", "blade_target", "impeller_target"]
# Diameters of ball and of flat ends, mm.
CUTTERS = [(True, 3.0), (True, 6.0), (True, 10.0), (False, 2.0), (False, 4.0), (False, 8.0)]
ACROSS = 41
# Steps that no edge of a part is a multiple of, so that no rim just touches an upright wall.
SHIFT = (0.0317, 0.0453)


def main(folder):
    cases = []
    for part in PARTS:
        corners, triangles = read_obj(folder / f"{part}.obj")
        surface = ocl.STLSurf()
        for t in triangles:
            surface.addTriangle(ocl.Triangle(*(ocl.Point(*map(float, corners[i])) for i in t)))
        low = [min(c[a] for c in corners) for a in range(3)]
        high = [max(c[a] for c in corners) for a in range(3)]
        for ball, diameter in CUTTERS:
            # Held in a variable: the batch keeps only a pointer to it.
            kind = ocl.BallCutter if ball else ocl.CylCutter
            cutter = kind(diameter, 200.0)
            batch = ocl.BatchDropCutter()
            batch.setSTL(surface)
            batch.setCutter(cutter)
            floor = low[2] - 100.0
            for j in range(ACROSS):
                for i in range(ACROSS):
                    x = low[0] - 2.0 + (high[0] - low[0] + 4.0) * (i + SHIFT[0]) / ACROSS
                    y = low[1] - 2.0 + (high[1] - low[1] + 4.0) * (j + SHIFT[1]) / ACROSS
                    batch.appendPoint(ocl.CLPoint(x, y, floor))
            batch.run()
            points = [
                [p.x, p.y, p.z if p.z > floor + 1.0 else None] for p in batch.getCLPoints()
            ]
            cases.append({"part": part, "ball": ball, "diameter": diameter, "points": points})
    json.dump({"cases": cases}, sys.stdout)


main(Path(sys.argv[1]))
