"""The operators of the bench by Python libraries, on voxels from a file."""

import sys
import time

import cc3d
import edt
import numpy
import scipy.fft
import scipy.ndimage

file, name = sys.argv[1:3]
nx, ny, nz = map(int, sys.argv[3:6])
solid = numpy.fromfile(file, dtype=numpy.uint8).reshape(nz, ny, nx).astype(bool)


def measure(label, runs, work):
    best = (float("inf"), float("inf"))
    for _ in range(runs):
        wall, cpu = time.perf_counter(), time.process_time()
        work()
        best = min(best, (time.perf_counter() - wall, time.process_time() - cpu))
    print(f"{name}: {label:<57} {best[0] * 1e3:9.2f} ms wall {best[1] * 1e3:9.2f} ms CPU")


y, x = numpy.mgrid[-9:10, -9:10]
disk = x * x + y * y <= 81
cylinder = numpy.repeat(disk[None], 60, axis=0)


def separated():
    """Disk, then run: the same element by scipy's fastest way."""
    wide = scipy.ndimage.binary_dilation(solid, disk[None])
    return scipy.ndimage.binary_dilation(wide, numpy.ones((60, 1, 1), bool), origin=(-30, 0, 0))


def distance():
    return scipy.ndimage.distance_transform_edt(~solid) <= 9


def transform():
    shape = [scipy.fft.next_fast_len(a + b - 1, real=True) for a, b in zip(solid.shape, cylinder.shape)]
    a = scipy.fft.rfftn(solid.astype(numpy.float32), shape, workers=2)
    b = scipy.fft.rfftn(cylinder.astype(numpy.float32), shape, workers=2)
    return scipy.fft.irfftn(a * b, shape, workers=2) > 0.5


measure("scipy binary_dilation, disk then run", 1, separated)
# By the whole element scipy takes half an hour; a slice of the grid tells its cost a voxel.
part = solid[: max(1, nz // 40)]
measure(f"scipy binary_dilation, cylinder r 9 × 60, {len(part)} of {nz} slices", 1,
        lambda: scipy.ndimage.binary_dilation(part, cylinder))
measure("scipy FFT, cylinder r 9 × 60", 1, transform)
measure("scipy distance_transform_edt", 1, distance)
measure("edt", 2, lambda: edt.edt(solid, parallel=2))
measure("cc3d, 26 neighbours", 3, lambda: cc3d.connected_components(solid, connectivity=26))
measure("scipy label, 26 neighbours", 1, lambda: scipy.ndimage.label(solid, numpy.ones((3, 3, 3))))
