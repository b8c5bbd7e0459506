"""Cost of raw images: `rectify`, its maps, and resampling of one image; and the accuracy of `undistort`.

    python benchmarks/bench_rectification.py

The rig is KITTI's raw pair (1392 x 512, cameras 02 and 03) with its published constants; the images are noise.
"""

from __future__ import annotations

from functools import partial

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.harness import arguments_of, best_ms, print_rows, write_json
from conetl.geometry import pose as se3
from conetl.geometry.lens import distort, field_radius, undistort
from conetl.geometry.rectification import rectify
from conetl.model.records import Camera, Lens, Rig
from conetl.perception.rectified_image import rectify_image

LEFT = Lens(model="brown", coefficients=(-0.3691481, 0.1968681, 1.353473e-3, 5.677587e-4, -0.06770705))
RIGHT = Lens(model="brown", coefficients=(-0.3639558, 0.1788651, 6.029694e-4, -3.922424e-4, -0.0538246))
LENSES = {
    "radial": Lens(model="radial", coefficients=(-0.28, 0.07)),
    "brown": LEFT,
    "rational": Lens(model="rational", coefficients=(1.5, 0.4, 4e-4, -3e-4, 0.02, 1.9, 0.8, 0.1)),
    "fisheye": Lens(model="fisheye", coefficients=(0.02, -0.01, 0.004, -0.0008)),
}


def kitti_like() -> Rig:
    left = Camera(width_px=1392, height_px=512, fx_px=959.8, fy_px=956.9, cx_px=696.0, cy_px=224.2, lens=LEFT)
    right = Camera(width_px=1392, height_px=512, fx_px=903.8, fy_px=902.0, cx_px=695.8, cy_px=224.3, lens=RIGHT)
    relative = se3.se3(Rotation.from_rotvec([-0.0017, 0.029, -0.0223]).as_matrix(), [0.5325, 0.0, 0.006])
    poses = {"body_SE3_left": se3.to_matrix4(np.eye(4)), "body_SE3_right": se3.to_matrix4(relative)}
    return Rig(rig_id="kitti-like", left=left, right=right, **poses)


def main() -> None:
    options = arguments_of(__doc__).parse_args()
    raw = kitti_like()
    flat = rectify(raw)
    print(f"rectify: {best_ms(lambda: rectify(raw), 5):.0f} ms per rig")
    size = {"width_px": 1242, "height_px": 375}
    small = flat.model_copy(update={side: getattr(flat, side).model_copy(update=size) for side in ("left", "right")})
    image = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 255, (512, 1392, 3), dtype=np.uint8), (0, 0), 1.5)
    rows: list[dict[str, object]] = []
    for threads in (1, 2):
        cv2.setNumThreads(threads)
        for rig in (small, flat):
            work = partial(rectify_image, image, rig, "left")
            rows.append(
                {
                    "image": f"{rig.left.width_px} x {rig.left.height_px}", "threads": threads,
                    "first image ms": best_ms(work, 1), "each further image ms": best_ms(work),
                }
            )  # fmt: skip
    print_rows("Resampling", rows)
    rng = np.random.default_rng(1)
    lenses: list[dict[str, object]] = []
    for name, lens in LENSES.items():
        reach = min(0.95 * field_radius(lens), 5.0 if name == "fisheye" else 1.5)
        angle, radius = rng.uniform(0, 2 * np.pi, 100_000), reach * np.sqrt(rng.uniform(0, 1, 100_000))
        ideal = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
        seen = distort(lens, ideal)
        worst = float(np.abs(undistort(lens, seen) - ideal).max())
        rate = 100 / best_ms(partial(undistort, lens, seen), 3)
        lenses.append({"undistort": name, "radius": reach, "largest error": worst, "M points/s": rate})
    print_rows("", lenses)
    write_json(options.json, {"resampling": rows, "undistort": lenses})


if __name__ == "__main__":
    main()
