"""How fast conetl finds the cones of one image, beside well-known networks on the same machine.

    .venv/bin/python benchmarks/bench_detect.py [--quick] [--json FILE] [--model FILE] [--pictures FOLDER]

Rows: conetl's whole detection (`conetl.perception.detector.detect_image`), its network alone on the tensor of the full-size
look, on the tensors of all looks, and two rivals with random weights (`rival_networks.py`), network alone. With `--pictures`
conetl's rows are measured on pictures of one's own, at most 24 from all over the folder; times are per picture.

One thread is one session of one thread; two threads are two Python threads, each with its own such session, working on the same
image at the same time. Needs the development packages (onnx).
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import platform
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

import cv2
import numpy as np
import onnxruntime
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from rival_networks import INPUT_NAME, Cost, network_cost, write_yolo11n, write_yolov3

from conetl.model.errors import ModelFileError
from conetl.perception.detector import LEAST_SIDE_PX, Detector, detect_image, load_detector
from conetl.perception.images import ImageFileError, read_image
from conetl.perception.model_card import shipped_model_path

Image = NDArray[np.uint8]
Work = Callable[[], object]

SIZES_PX = ((1242, 375), (640, 640))
"""Width and height of the images."""
SCORE_THRESHOLD = 0.3
WARM_UPS = 2
RUNS = 12
QUICK_RUNS = 3
LEAST_SHARE = 0.9
"""Threads that got less of a core than this were disturbed."""
WHOLE, ALONE, ALL_LOOKS = "conetl whole", "conetl network", "conetl network, all looks"
YOLOV3, YOLO11N = "YOLOv3", "YOLO11n-sized"
MOST_PICTURES = 24


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
    """Stands before a detector's session, passes every run on, and keeps what the network was given."""

    session: onnxruntime.InferenceSession
    fed: list[tuple[Any, dict[str, NDArray[Any]]]] = dataclasses.field(default_factory=list)

    def run(self, outputs: Any, feeds: dict[str, NDArray[Any]], *rest: Any) -> Any:
        self.fed.append((outputs, feeds))
        return self.session.run(outputs, feeds, *rest)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.session, name)


def sample_image(width_px: int, height_px: int) -> tuple[Image, str]:
    """A picture of the sample drives cut to the wanted shape and resized, or noise on a gradient; and which of them it is."""
    drives = Path(__file__).resolve().parents[1] / "data" / "drives"
    for path in sorted(drives.glob("*/image_02/data/*")):
        picture = cv2.imread(str(path))
        if picture is None:
            raise SystemExit(
                f"{path}: not a picture that can be read; expected a JPEG or PNG file: fetch the sample again"
            )
        height, width = picture.shape[:2]
        scale = min(width / width_px, height / height_px)
        columns, rows = round(width_px * scale), round(height_px * scale)
        left, top = (width - columns) // 2, (height - rows) // 2
        cut = picture[top : top + rows, left : left + columns]
        image = np.asarray(cv2.resize(cut, (width_px, height_px)), np.uint8)
        return image, f"{path.relative_to(drives)}, cut and resized"
    random = np.random.default_rng(0)
    gradient = np.linspace(40, 200, height_px)[:, None, None]
    noisy = gradient + random.normal(0, 20, (height_px, width_px, 3))
    return np.clip(noisy, 0, 255).astype(np.uint8), "noise on a gradient (no sample drives in data/drives)"


def measure(what: str, size_px: tuple[int, int], works: Sequence[Work], runs: int, images: int = 1) -> Timing:
    """Time `runs` calls of each work on `images` images, each in its own thread, all at the same time, after warm-ups there."""
    barrier = threading.Barrier(len(works))
    times_s: list[float] = []
    cpu_s: list[float] = []
    spans: list[tuple[float, float]] = []
    failures: list[Exception] = []

    def worker(work: Work) -> None:
        try:
            for _ in range(WARM_UPS):
                work()
            barrier.wait()
            cpu_start_s = time.thread_time()
            ticks = [time.perf_counter()]
            for _ in range(runs):
                work()
                ticks.append(time.perf_counter())
        except Exception as error:
            barrier.abort()
            failures.append(error)
            return
        cpu_s.append(time.thread_time() - cpu_start_s)
        times_s.extend((np.diff(ticks) / images).tolist())
        spans.append((ticks[0], ticks[-1]))

    threads = [threading.Thread(target=worker, args=(work,)) for work in works]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if failures:
        # The thread that failed first broke the barrier for the others.
        raise next((error for error in failures if not isinstance(error, threading.BrokenBarrierError)), failures[0])
    wall_s = max(end for _, end in spans) - min(start for start, _ in spans)
    return Timing(
        what, *size_px, threads=len(works), runs=runs, min_ms=min(times_s) * 1e3, median_ms=median(times_s) * 1e3,
        images_per_s=len(works) * runs * images / wall_s, cores_used=sum(cpu_s) / wall_s,
    )  # fmt: skip


def images_of(folder: Path) -> list[Image]:
    """At most MOST_PICTURES of a folder, from all over it; all must have the size of the first."""
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in {".jpg", ".jpeg", ".png"})
    try:
        pictures = [read_image(path) for path in paths[:: -(-len(paths) // MOST_PICTURES) or 1]]
    except ImageFileError as error:
        raise SystemExit(f"{error}") from error
    if not pictures or len({picture.shape for picture in pictures}) > 1 or min(pictures[0].shape[:2]) < LEAST_SIDE_PX:
        raise SystemExit(f"{folder}: expected JPEG or PNG pictures of one size, {LEAST_SIDE_PX} px and more a side")
    return pictures


def measure_conetl(
    detectors: Sequence[Detector], images: Sequence[Image], runs: int
) -> tuple[list[Timing], dict[str, Any]]:
    """Rows of the whole detection and of the network alone, per image, and what the detection consists of."""
    size_px = (images[0].shape[1], images[0].shape[0])
    recorders = [RecordingSession(detectors[0].session) for _ in images]
    cones = [
        detect_image(dataclasses.replace(detectors[0], session=recorder), image, score_threshold=SCORE_THRESHOLD)
        for recorder, image in zip(recorders, images, strict=True)
    ]
    # The first look is the one at full size.
    first, every = [recorder.fed[0] for recorder in recorders], [fed for recorder in recorders for fed in recorder.fed]

    def detect_all(detector: Detector) -> None:
        for image in images:
            detect_image(detector, image, score_threshold=SCORE_THRESHOLD)

    def run_all(detector: Detector, fed: list[tuple[Any, dict[str, NDArray[Any]]]]) -> None:
        for outputs, feeds in fed:
            detector.session.run(outputs, feeds)

    whole: list[Work] = [partial(detect_all, each) for each in detectors]
    alone: list[Work] = [partial(run_all, each, first) for each in detectors]
    all_looks: list[Work] = [partial(run_all, each, every) for each in detectors]
    timings = [
        measure(what, size_px, works[:count], runs, len(images))
        for count in range(1, len(detectors) + 1)
        for what, works in ((WHOLE, whole), (ALONE, alone), (ALL_LOOKS, all_looks))
    ]
    others = [list(next(iter(feeds.values())).shape) for recorder in recorders for _, feeds in recorder.fed[1:]]
    full_size = list(next(iter(first[0][1].values())).shape)
    return timings, {
        "size_px": list(size_px), "pictures": len(images), "full_size": full_size,
        "other_looks": others, "cones_found": sum(map(len, cones)),
    }  # fmt: skip


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
    """Ratios of the least times per image with one thread: the least is the steadiest number on a shared machine."""
    least = {(row.what, row.width_px, row.height_px): row.min_ms for row in timings if row.threads == 1}
    result = {}
    whole = {f"{width}x{height}": (width, height) for what, width, height in least if what == WHOLE}
    for what, its_name in ((ALONE, "network alone"), (ALL_LOOKS, "network alone, all looks")):
        for text, size in whole.items():
            result[f"whole detection / {its_name}, {text}"] = least[WHOLE, *size] / least[what, *size]
    for rival, side_px in ((YOLOV3, 416), (YOLO11N, 640)):
        for text, size in whole.items():
            ratio = least[rival, side_px, side_px] / least[WHOLE, *size]
            result[f"{rival} {side_px}x{side_px} / conetl's whole detection, {text}"] = ratio
    return result


def machine() -> dict[str, Any]:
    """What the numbers were measured on."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [
            line.split(":", 1)[1].strip() for line in cpuinfo.read_text().splitlines() if line.startswith("model name")
        ]
        model = names[0] if names else model
    return {
        "cpu": model,
        "cores": os.cpu_count(),
        "load_before": round(os.getloadavg()[0], 2),
        "python": platform.python_version(),
        "onnxruntime": onnxruntime.__version__,
    }


def print_report(console: Console, report: dict[str, Any]) -> None:
    host = report["machine"]
    console.print(
        f"{host['cpu']}, {host['cores']} cores, load {host['load_before']} before the start; onnxruntime {host['onnxruntime']}, "
        f"Python {host['python']}"
    )
    table = Table("what", "image", "threads", "min ms", "median ms", "images/s", "cores", title="Detection, CPU only")
    for column in table.columns[2:]:
        column.justify = "right"
    for row in report["timings"]:
        table.add_row(
            row["what"], f"{row['width_px']}x{row['height_px']}", str(row["threads"]),
            f"{row['min_ms']:.1f}", f"{row['median_ms']:.1f}", f"{row['images_per_s']:.2f}", f"{row['cores_used']:.2f}",
        )  # fmt: skip
    console.print(table)
    console.print(
        f"{report['timings'][0]['runs']} runs per row and thread after {WARM_UPS} warm-ups, each thread with its own session. "
        "Rivals: network alone."
    )
    crowded = [row for row in report["timings"] if row["cores_used"] < LEAST_SHARE * row["threads"]]
    if crowded:
        console.print(
            f"[yellow]Other programs took the processor in {len(crowded)} of {len(report['timings'])} rows: where 'cores' is "
            "below 'threads', the median is too long and images/s too few. Measure again on an idle machine.[/yellow]"
        )
    for network in report["networks"]:
        console.print(
            f"{network['what']} ({network['input']}): {network['parameters'] / 1e6:.2f} M parameters, "
            f"{network['gflop']:.2f} GFLOP, {network['arithmetic']}"
        )
    for detection in report["detections"]:
        looks = Counter("x".join(map(str, shape)) for shape in detection["other_looks"])
        others = ", ".join(f"{count} of {shape}" for shape, count in sorted(looks.items())) or "none"
        console.print(
            f"conetl at {detection['size_px'][0]}x{detection['size_px'][1]}: network input "
            f"{'x'.join(map(str, detection['full_size']))}, further looks: {others}; {detection['cones_found']} cones found; "
            f"{detection['pictures']} image(s): {detection['image']}"
        )
    for name, value in report["ratios"].items():
        console.print(f"{name}: [bold]{value:.2f}[/bold]")


def run(model_path: Path, runs: int, threads: int, pictures: Path | None) -> dict[str, Any]:
    """Measure everything; the report is what `--json` writes."""
    report: dict[str, Any] = {
        "machine": machine(),
        "score_threshold": SCORE_THRESHOLD,
        "networks": [],
        "detections": [],
    }
    timings: list[Timing] = []

    def note_cost(what: str, path: Path, shape: Sequence[int]) -> None:
        cost: Cost = network_cost(path, shape)
        report["networks"].append({"what": what, "input": "x".join(map(str, shape)), **dataclasses.asdict(cost)})

    detectors = [load_detector(model_path, threads=1) for _ in range(threads)]
    report["model"] = f"{detectors[0].name} {detectors[0].version}"
    if pictures is None:
        sources = [([image], source) for image, source in (sample_image(*size_px) for size_px in SIZES_PX)]
    else:
        sources = [(images_of(pictures), f"{pictures.parent.name}/{pictures.name}")]
    for images, source in sources:
        rows, detection = measure_conetl(detectors, images, runs)
        timings += rows
        report["detections"].append({**detection, "image": source})
        note_cost(report["model"], model_path, detection["full_size"])
    del detectors
    with tempfile.TemporaryDirectory(prefix="conetl-bench-") as folder:
        for what, write, size in ((YOLOV3, write_yolov3, 416), (YOLO11N, write_yolo11n, 640)):
            path = Path(folder) / f"{what}.onnx"
            write(path, size_px=size)
            note_cost(f"{what}, random weights", path, (1, 3, size, size))
            timings += measure_rival(path, what, size, sample_image(size, size)[0], runs, threads)
    report["timings"] = [dataclasses.asdict(row) for row in timings]
    report["ratios"] = ratios(timings)
    return report


def main() -> int:
    parser = argparse.ArgumentParser(description="Measure the speed of conetl's detection beside well-known networks.")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_RUNS} runs per row instead of {RUNS}")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the numbers to FILE")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="measure conetl on pictures of your own")
    parser.add_argument("--model", type=Path, metavar="FILE", help="another conetl model than the shipped one")
    arguments = parser.parse_args()
    # One thread shall mean one thread for OpenCV, too.
    cv2.setNumThreads(1)
    if arguments.pictures is not None and not arguments.pictures.is_dir():
        parser.error(f"--pictures {arguments.pictures}: not a folder")
    if arguments.json is not None and not arguments.json.parent.is_dir():
        parser.error(f"--json {arguments.json}: its folder does not exist; create it first")
    try:
        report = run(
            arguments.model or shipped_model_path(), QUICK_RUNS if arguments.quick else RUNS, 2, arguments.pictures
        )
    except ModelFileError as error:
        parser.error(str(error))
    print_report(Console(soft_wrap=True), report)
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(report, indent=2) + "\n", encoding="utf-8")
        sys.stdout.write(f"wrote {arguments.json}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
