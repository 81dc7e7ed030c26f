"""The version of the algorithm, which every result names, and what each version changed."""

from collections.abc import Mapping

CHANGES: Mapping[str, tuple[str, str]] = {
    "1": (
        "visual hull of 16 views; its volume divided by what a sphere's hull has too much",
        "stones 0.070 mm from the true surface, volumes +2.0 %",
    ),
    "2": (
        "the body is estimated within the hull; `calibrate` adjusts all cameras together",
        "stones 0.034 mm; volumes +0.10 %, rms 0.49",
    ),
    "3": (
        "views are compared with the empty rig; where that cannot be trusted the network finds the stone",
        "no figure kept",
    ),
    "4": (
        "edges at the steepest slope, a better network; no tangent beside a gap of the outline",
        "a cube with a hidden corner had lost it by 5 mm; stones 0.033 mm",
    ),
    "5": (
        "the estimate's inner body and the distance fields are computed otherwise, much faster",
        "volumes by up to 6e-5 and by less than 5e-5 of themselves",
    ),
    "6": (
        "the check of views samples small outlines otherwise; the mean of the empty rig is rounded otherwise",
        "residuals by up to 0.03 px, outlines by up to 1e-4 px",
    ),
    "7": (
        "grey levels on the network's side in single precision; a sphere's excess from stored directions",
        "no figure kept",
    ),
    "8": (
        "points that stand out by less than a share of the extent count for no size; that extent is taken "
        "otherwise",
        "sizes by up to 1e-5 of themselves",
    ),
    "9": (
        "distance fields of every second pixel",
        "volumes by up to 1.5e-4 at 5 mm, 2e-5 at 25 mm",
    ),
    "10": (
        "sizes without bias from noise at the points of contact; edges placed by their own blur; `quality` "
        "from the stated uncertainty",
        "maximum Feret of a cube 0.07 mm short, then 0.01; of a sphere it had been 0.1 mm large",
    ),
    "11": (
        "averaged contacts, faces seen edge-on, the least width of round bars; volume coefficient 1.11; "
        "network trained on F2 to F8",
        "sizes of sphere, cylinder and cube within 0.02 mm; a cube's face had stood out by 0.15 mm",
    ),
    "12": (
        '`[body] kind = "photo"` is the default: pixels find dents, and what they cannot resolve is stated',
        "stones 0.037 -> 0.012 mm, volumes +0.66 -> -0.19 %; errors beyond three sigmas 13 -> 1 of 471",
    ),
    "13": (
        "dents that few views see to the bottom; the estimate's edges no longer stand out of rough bodies",
        "edges 0.012 -> 0.005 mm too far out; largest error of a volume 1.2 -> 0.40 % (F8)",
    ),
    "14": (
        "a membrane between what pixels show; the third pass is made twice",
        "stones 0.0253 -> 0.0232 mm, largest error of a volume 0.40 -> 0.36 % (F8)",
    ),
    "15": (
        "nodes twice as dense, deeper dents of large stones, less taken for chance",
        "stones 0.020 mm (F8), 0.023 (F2.0); largest error of a volume 0.31 % (F2.0)",
    ),
    "16": (
        "smooth stones no longer too small; steeper views and a third coarse pass see deep dents",
        "stones 0.019 mm (F8), 0.023 (F2.0); largest error of a volume 0.39 % (F2.0)",
    ),
    "17": (
        "as 16 by default; hulls that do not end at the edges (`--field view_count`, `--method paper`, "
        "views that may disagree) are no longer corrected",
        "such a sphere of 15 mm had come out 1.5 % too small",
    ),
    "18": (
        "dents searched again where patches look unlike, with more views; noise by grey level; folds "
        "repaired, not given up; no tunnels where rock is as grey as a spot of the wall; contacts on "
        "borders of unknown set no size; sieve size of a cube with a bump; sigmas and word by what the "
        "views together leave open and pixels do not show",
        "[real rock](../../tests/benchmarks/README.md#real-rock-before-a-spotted-wall); "
        "synthetic stones as before",
    ),
    "19": (
        "smaller patches find more of the dents; up to a quarter of the views may contradict the others; a fold "
        "goes back alone; a contact far from the refined surface sets no size; volume's sigma by how views disagree",
        "[real rock](../../tests/benchmarks/README.md#real-rock-before-a-spotted-wall); "
        "synthetic stones as before",
    ),
    "20": (
        "volume coefficient 1.03, fitted to the estimate of today, with 8 to 16 views alike",
        "volumes of estimates from 16 views 0.3 % larger, from 8 views 0.8 %",
    ),
    "21": (
        "each point of the refined surface is aligned to its grey levels by itself; dents are searched again in "
        "two rounds; a hump alone on an even face is chance",
        "stones of real rock 0.040 -> 0.032 mm, of their surface off by more than 0.3 mm 1.2 -> 0.7 %",
    ),
    "22": (
        "no result is `good` where the pixels were left out for lack of time, or where a silhouette is that of two "
        "stones which touch",
        "words alone: two stones of 20 and 8 mm that touch were a good one, 7 % too large",
    ),
}
"""What each version changed in results, and a figure of that time; what may change a result or adds a measure gets one.

`python -m service.results.table` puts them into `CHANGES_GUIDE`.
"""
CHANGES_GUIDE = "service/remeasuring/README.md"
"""Guide that has them as a table."""
ALGORITHM_VERSION = list(CHANGES)[-1]
"""Version of the algorithm: the last of `CHANGES`."""
