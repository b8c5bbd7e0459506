"""Time to detect the cones of one image, beside well-known networks on the same machine.

    .venv/bin/python benchmarks/bench_detect.py [--runs 12] [--json FILE] [--model FILE] [--images FOLDER]

Rows: the complete detection (`conetl.perception.detector.detect_image`) of cones and of all classes, its network alone on the
tensor of the full-size pass and on the tensors of all passes, and two rivals with random weights (`rival_networks.py`), network
alone. `--images` measures conetl's rows on at most 24 images of a folder; times are per image.

One thread is one session of one thread; two threads are two Python threads, each with its own such session, working on the same
image at the same time. Requires the development packages (onnx).
"""

from __future__ import annotations

import dataclasses
import os
import platform
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import numpy as np
import onnxruntime
from numpy.typing import NDArray

from benchmarks.harness import arguments_of, load, print_rows, write_json
from benchmarks.rival_networks import INPUT_NAME, write_yolo11n, write_yolov3
from conetl.model.errors import ModelFileError
from conetl.model.feature_classes import CONE
from conetl.perception.detector import MIN_SIDE_PX, Detector, detect_image, load_detector
from conetl.perception.images import ImageFileError, read_image
from conetl.perception.model_card import shipped_model_path
from tests.folders import SAMPLE

Image = NDArray[np.uint8]
Work = Callable[[], object]

#: Width and height of the images.
SIZES_PX = ((1242, 375), (640, 640))
SCORE_THRESHOLD = 0.3
WARM_UPS = 2
#: Threads with a smaller share of a core were disturbed by other programs.
LEAST_SHARE = 0.9
WHOLE, ALONE, ALL_PASSES = "conetl whole", "conetl network", "conetl network, all passes"
#: What is searched for, by the ending of the names of its rows.
SEARCHED: dict[str, tuple[str, ...] | None] = {"": (CONE,), ", all classes": None}
YOLOV3, YOLO11N = "YOLOv3", "YOLO11n-sized"
MOST_IMAGES = 24


@dataclasses.dataclass(frozen=True)
class Timing:
    """One row of the table. Times are per image as one thread sees them; rates and cores are of all threads together."""

    what: str
    width_px: int
    height_px: int
    threads: int
    runs: int
    min_ms: float
    median_ms: float
    images_per_s: float
    cores_used: float
    """Processor time over wall time; clearly below `threads` where other programs took the cores."""


@dataclasses.dataclass
class RecordingSession:
    """A wrapper of a detector's session that records the inputs of the network."""

    session: onnxruntime.InferenceSession
    fed: list[tuple[Any, dict[str, NDArray[Any]]]] = dataclasses.field(default_factory=list)

    def run(self, outputs: Any, feeds: dict[str, NDArray[Any]], *rest: Any) -> Any:
        self.fed.append((outputs, feeds))
        return self.session.run(outputs, feeds, *rest)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.session, name)


def sample_image(width_px: int, height_px: int) -> tuple[Image, str]:
    """An image of the sample drives, cut to the shape and resized; and its name."""
    path = min(SAMPLE.glob("image_02/data/*"))
    image = read_image(path)
    height, width = image.shape[:2]
    scale = min(width / width_px, height / height_px)
    columns, rows = round(width_px * scale), round(height_px * scale)
    left, top = (width - columns) // 2, (height - rows) // 2
    resized = cv2.resize(image[top : top + rows, left : left + columns], (width_px, height_px))
    return np.asarray(resized, np.uint8), f"{path.relative_to(SAMPLE.parent)}, cut and resized"


def measure(what: str, size_px: tuple[int, int], works: Sequence[Work], runs: int, images: int = 1) -> Timing:
    """Time `runs` calls of each work on `images` images, each in its own thread at the same time, after warm-ups."""
    barrier = threading.Barrier(len(works))

    def worker(work: Work) -> tuple[list[float], float]:
        for _ in range(min(WARM_UPS, runs)):
            work()
        barrier.wait()
        cpu_start_s, ticks = time.thread_time(), [time.perf_counter()]
        for _ in range(runs):
            work()
            ticks.append(time.perf_counter())
        return ticks, time.thread_time() - cpu_start_s

    with ThreadPoolExecutor(len(works)) as pool:
        done = list(pool.map(worker, works))
    times_s = np.concatenate([np.diff(ticks) for ticks, _ in done]) / images
    wall_s = max(ticks[-1] for ticks, _ in done) - min(ticks[0] for ticks, _ in done)
    return Timing(
        what, *size_px, threads=len(works), runs=runs, min_ms=float(times_s.min()) * 1e3, median_ms=median(times_s) * 1e3,
        images_per_s=len(works) * runs * images / wall_s, cores_used=sum(cpu_s for _, cpu_s in done) / wall_s,
    )  # fmt: skip


def images_of(folder: Path) -> list[Image]:
    """At most MOST_IMAGES from all over a folder; all must have the size of the first."""
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in {".jpg", ".jpeg", ".png"})
    images = [read_image(path) for path in paths[:: -(-len(paths) // MOST_IMAGES) or 1]]
    if not images or len({image.shape for image in images}) > 1 or min(images[0].shape[:2]) < MIN_SIDE_PX:
        raise SystemExit(f"{folder}: expected JPEG or PNG images of one size, at least {MIN_SIDE_PX} px per side")
    return images


def measure_conetl(
    detectors: Sequence[Detector], images: Sequence[Image], runs: int
) -> tuple[list[Timing], dict[str, Any]]:
    """Rows of the complete detection and of the network alone, per image, and the passes of the detection by what is searched."""
    size_px = (images[0].shape[1], images[0].shape[0])
    timings: list[Timing] = []
    passes: dict[str, Any] = {}
    for ending, categories in SEARCHED.items():
        recorders = [RecordingSession(detectors[0].session) for _ in images]
        found = [
            detect_image(
                dataclasses.replace(detectors[0], session=recorder), image,
                score_threshold=SCORE_THRESHOLD, categories=categories,
            )
            for recorder, image in zip(recorders, images, strict=True)
        ]  # fmt: skip
        # The first pass is the one at full size.
        first, every = (
            [recorder.fed[0] for recorder in recorders],
            [fed for recorder in recorders for fed in recorder.fed],
        )
        works: dict[str, list[Work]] = {
            WHOLE + ending: [partial(_detect_all, each, images, categories) for each in detectors],
            ALL_PASSES + ending: [partial(_run_all, each, every) for each in detectors],
        }
        if not ending:  # the first pass does not depend on the classes
            works[ALONE] = [partial(_run_all, each, first) for each in detectors]
        timings += [
            measure(what, size_px, each[:count], runs, len(images))
            for count in range(1, len(detectors) + 1)
            for what, each in works.items()
        ]
        others = [list(next(iter(feeds.values())).shape) for recorder in recorders for _, feeds in recorder.fed[1:]]
        passes[WHOLE + ending] = {"other_passes": others, "objects_found": sum(map(len, found))}
    full_size = list(next(iter(first[0][1].values())).shape)
    return timings, {"size_px": list(size_px), "pictures": len(images), "full_size": full_size, "passes": passes}


def _detect_all(detector: Detector, images: Sequence[Image], categories: tuple[str, ...] | None) -> None:
    for image in images:
        detect_image(detector, image, score_threshold=SCORE_THRESHOLD, categories=categories)


def _run_all(detector: Detector, fed: Sequence[tuple[Any, dict[str, NDArray[Any]]]]) -> None:
    for outputs, feeds in fed:
        detector.session.run(outputs, feeds)


def measure_rival(path: Path, what: str, size_px: int, image: Image, runs: int, threads: int) -> list[Timing]:
    """Rows of a rival's network alone on the image, squeezed to its input. Raises ValueError if its outputs are not finite."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    sessions = [
        onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"]) for _ in range(threads)
    ]
    feeds = {INPUT_NAME: cv2.dnn.blobFromImage(image, 1 / 255, (size_px, size_px), swapRB=True)}
    if not all(np.isfinite(output).all() for output in sessions[0].run(None, feeds)):
        raise ValueError(f"{what}: the random network gives values that are not finite; its weights are scaled badly")
    works: list[Work] = [lambda session=each: session.run(None, feeds) for each in sessions]  # type: ignore[misc]
    return [measure(what, (size_px, size_px), works[:count], runs) for count in range(1, threads + 1)]


def ratios(timings: Sequence[Timing]) -> dict[str, float]:
    """Ratios of the shortest times per image with one thread, the most stable figure on a shared machine."""
    least = {(row.what, row.width_px, row.height_px): row.min_ms for row in timings if row.threads == 1}
    result = {}
    whole = {f"{width}x{height}": (width, height) for what, width, height in least if what == WHOLE}
    for ending in SEARCHED:
        for what, its_name in ((ALONE, "network alone"), (ALL_PASSES + ending, "network alone, all passes")):
            for text, size in whole.items():
                ratio = least[WHOLE + ending, *size] / least[what, *size]
                result[f"whole detection{ending} / {its_name}, {text}"] = ratio
    for rival, side_px in ((YOLOV3, 416), (YOLO11N, 640)):
        for text, size in whole.items():
            ratio = least[rival, side_px, side_px] / least[WHOLE, *size]
            result[f"{rival} {side_px}x{side_px} / conetl's whole detection, {text}"] = ratio
    return result


def machine() -> dict[str, Any]:
    """Processor and versions."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return {
        "cpu": names[0] if names else platform.machine(),
        "cores": os.cpu_count(),
        "load_before": load(),
        "python": platform.python_version(),
        "onnxruntime": onnxruntime.__version__,
    }


def print_report(report: dict[str, Any]) -> None:
    print(", ".join(f"{name} {value}" for name, value in report["machine"].items()))
    print_rows("Detection, CPU only; rivals: network alone", report["timings"])
    print(
        f"{report['timings'][0]['runs']} runs per row and thread after {WARM_UPS} warm-ups, each thread with its own session."
    )
    crowded = [row for row in report["timings"] if row["cores_used"] < LEAST_SHARE * row["threads"]]
    if crowded:
        print(
            f"Other programs used the processor in {len(crowded)} of {len(report['timings'])} rows: where cores_used is below "
            "threads, the median is too long. Measure again on an idle machine."
        )
    for detection in report["detections"]:
        print(
            f"conetl at {detection['size_px'][0]}x{detection['size_px'][1]}: network input "
            f"{'x'.join(map(str, detection['full_size']))}; {detection['pictures']} image(s): {detection['image']}"
        )
        for what, passes in detection["passes"].items():
            shapes = Counter("x".join(map(str, shape)) for shape in passes["other_passes"])
            others = ", ".join(f"{count} of {shape}" for shape, count in sorted(shapes.items())) or "none"
            print(f"  {what}: {passes['objects_found']} objects found; further passes: {others}")
    print_rows("", [{"ratio": name, "value": value} for name, value in report["ratios"].items()])


def run(model_path: Path, runs: int, threads: int, pictures: Path | None) -> dict[str, Any]:
    """All figures, as `--json` writes them."""
    report: dict[str, Any] = {"machine": machine(), "score_threshold": SCORE_THRESHOLD, "detections": []}
    timings: list[Timing] = []
    detectors = [load_detector(model_path, threads=1) for _ in range(threads)]
    report["model"] = f"{detectors[0].card.name} {detectors[0].card.version}"
    if pictures is None:
        sources = [([image], source) for image, source in (sample_image(*size_px) for size_px in SIZES_PX)]
    else:
        sources = [(images_of(pictures), f"{pictures.parent.name}/{pictures.name}")]
    for images, source in sources:
        rows, detection = measure_conetl(detectors, images, runs)
        timings += rows
        report["detections"].append({**detection, "image": source})
    del detectors
    with tempfile.TemporaryDirectory(prefix="conetl-bench-") as folder:
        for what, write, size in ((YOLOV3, write_yolov3, 416), (YOLO11N, write_yolo11n, 640)):
            path = Path(folder) / f"{what}.onnx"
            write(path, size_px=size)
            timings += measure_rival(path, what, size, sample_image(size, size)[0], runs, threads)
    report["timings"] = [dataclasses.asdict(row) for row in timings]
    report["ratios"] = ratios(timings)
    return report


def main() -> None:
    parser = arguments_of(__doc__)
    parser.add_argument("--runs", type=int, default=12, help="per row and thread, after at most two to warm up")
    parser.add_argument("--images", type=Path, metavar="FOLDER", help="measure conetl on images of your own")
    parser.add_argument("--model", type=Path, metavar="FILE", help="another conetl model than the shipped one")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    if options.images is not None and not options.images.is_dir():
        parser.error(f"--images {options.images}: not a folder")
    try:
        report = run(options.model or shipped_model_path(), options.runs, 2, options.images)
    except (ModelFileError, ImageFileError) as error:
        parser.error(str(error))
    print_report(report)
    write_json(options.json, report)


if __name__ == "__main__":
    main()
