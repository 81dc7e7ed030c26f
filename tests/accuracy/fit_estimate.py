"""Where the coefficients of the estimated body and of its volume come from.

Superellipsoids, ellipsoids smooth and rough, boxes, cylinders and polyhedra smooth and rough (support/forms.py)
are seen by rigs with deviations. The three coefficients of `pipeline.estimate.smoothness` are those of the
least mean distance along rays from the centre to the true surface, each form weighing the same; then the
`gap_share` of the volume is that of least squares, for all views and for some of them alone. The stones and
standards that the product is judged by take no part in it.

Run: .venv/bin/python tests/accuracy/fit_estimate.py [--bodies 6] [--seed 1]
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import scipy.optimize
from numpy.typing import NDArray
from rich.console import Console
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.forms import FORMS, form, hull_of, silhouettes_of

from pipeline.estimate import estimate_body
from pipeline.estimate.smoothness import OFFSET, PER_BULGE_SHARE, PER_LOCAL_SHARE, bulge_share
from pipeline.estimate.surface import InnerSurface, inner_surface
from pipeline.measuring.volume_correction import SYNTHETIC
from pipeline.meshing import ParticleMesh
from pipeline.rig.cameras import RigCalibration
from pipeline.rig.design import as_built, nominal_rig
from pipeline.segmentation.silhouette import SilhouetteSet
from pipeline.synthesis.bundles import stream
from pipeline.synthesis.placement import tumble
from pipeline.synthesis.shading import embree_scene
from pipeline.views.prepared import prepare_views

Array = NDArray[np.float64]

N_RAYS = 2500
FEWER_VIEWS = (12, 10, 8)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sample:
    """One body, along rays from its centre."""

    form: str
    excess_mm: Array  # (N,) of the hull over the inner body
    true_mm: Array  # (N,) of the true surface over it
    cosines: Array  # (N,) of the ray and the true normal: from lengths along rays to distances
    inner: InnerSurface
    bulge_share: float
    gap: float  # ln(V_hull / V_estimate)
    missing: float  # ln(V_hull / V_true)
    fewer: Mapping[int, tuple[float, float]]  # gap and missing with some of the views alone, by their number

    def distance_mm(self, coefficients: Sequence[float]) -> float:
        """Mean distance of the estimate to the true surface."""
        offset, per_local, per_bulge = coefficients
        smooth = np.clip(offset + per_local * self.inner.local_share + per_bulge * self.bulge_share, 0, 1)
        estimate_mm = smooth * np.minimum(self.inner.half_heights, self.excess_mm)
        return float(np.mean(np.abs(estimate_mm - self.true_mm) * self.cosines))


def sample(name: str, number: int, seed: int) -> Sample:
    """A random body of a form, in a random pose, seen by a random rig."""
    rng = stream(seed, FORMS.index(name), number)
    rig = as_built(nominal_rig(), int(rng.integers(1 << 31)))
    truth = tumble(form(name, rng), rig, rng).world_mesh
    silhouettes = silhouettes_of(truth, rig, rng)
    hull, gap, missing = gap_and_missing(silhouettes, rig, truth.volume)
    order = rng.permutation(rig.camera_ids)
    some = {n: {camera: silhouettes[camera] for camera in order[:n]} for n in FEWER_VIEWS}

    center_mm = (hull.vertices_mm.min(axis=0) + hull.vertices_mm.max(axis=0)) / 2
    from_center_mm = rng.permutation(hull.vertices_mm)[:N_RAYS] - center_mm
    radii_mm = np.linalg.norm(from_center_mm, axis=1)
    directions = from_center_mm / radii_mm[:, None]
    inner = inner_surface(
        prepare_views(silhouettes, rig), center_mm, center_mm + directions
    )  # shares of 1 mm
    if isinstance(inner, str):
        raise AssertionError(f"{name} {number}: {inner}")
    starts = np.broadcast_to(center_mm.astype(np.float32), directions.shape).copy()
    hit = embree_scene(truth).run(starts, directions.astype(np.float32), output=True)
    normals = hit["Ng"] / np.linalg.norm(hit["Ng"], axis=1, keepdims=True)
    return Sample(
        form=name,
        excess_mm=np.maximum(radii_mm - inner.radii, 0),
        true_mm=hit["tfar"] - np.minimum(inner.radii, radii_mm),
        cosines=np.abs(np.einsum("ij,ij->i", normals, directions)),
        inner=inner,
        bulge_share=bulge_share(inner.half_heights / radii_mm, inner.radii / radii_mm),
        gap=gap,
        missing=missing,
        fewer={n: gap_and_missing(seen, rig, truth.volume)[1:] for n, seen in some.items()},
    )


def gap_and_missing(
    silhouettes: SilhouetteSet, rig: RigCalibration, true_mm3: float
) -> tuple[ParticleMesh, float, float]:
    """Return the hull, and the logarithms of its volume by the estimate's and by the true one."""
    hull = hull_of(silhouettes, rig)
    estimate = estimate_body(hull, prepare_views(silhouettes, rig))
    volumes_mm3 = np.array([estimate.volume_mm3, true_mm3])
    gap, missing = np.log(estimate.hull_volume_mm3 / volumes_mm3)
    return hull, float(gap), float(missing)


def main(n_bodies: int, seed: int) -> None:
    cv2.setNumThreads(1)
    threadpool_limits(1)
    console = Console(highlight=False, width=120)
    samples = [sample(name, number, seed) for name in FORMS for number in range(n_bodies)]
    today = (OFFSET, PER_LOCAL_SHARE, PER_BULGE_SHARE)

    def mean_mm(coefficients: Sequence[float], names: Sequence[str] = FORMS) -> float:
        return float(np.mean([s.distance_mm(coefficients) for s in samples if s.form in names]))

    fitted = scipy.optimize.minimize(mean_mm, today, method="Nelder-Mead", options={"maxfev": 200})
    console.print(f"OFFSET, PER_LOCAL_SHARE, PER_BULGE_SHARE = {np.round(fitted.x, 2)}, in the code {today}")
    console.print(
        f"mean distance {1000 * fitted.fun:.2f} um, with those in the code {1000 * mean_mm(today):.2f} um"
    )
    for name in FORMS:
        console.print(f"  {name:18} {1000 * mean_mm(today, [name]):6.1f} um")
    console.print(f"gap_share in the code {SYNTHETIC.gap_share}, fitted")
    for n, pairs in {
        16: [(s.gap, s.missing) for s in samples],
        **{n: [s.fewer[n] for s in samples] for n in FEWER_VIEWS},
    }.items():
        gaps, missing = np.array(pairs).T
        gap_share = float(gaps @ missing / (gaps @ gaps))
        errors = 100 * (missing - SYNTHETIC.gap_share * gaps)
        rms = np.sqrt(np.mean(errors**2))
        console.print(
            f"  {n:2} views {gap_share:.3f}; volume by the code {errors.mean():+.2f} %, rms {rms:.2f} %"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--bodies", type=int, default=6, help="of each form")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    main(arguments.bodies, arguments.seed)
