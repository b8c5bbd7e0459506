"""The same drive by threads, processes and Dask, and from object storage: one Prefect server for all of them."""

from __future__ import annotations

import subprocess
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
import psutil
import pytest
from distributed import Client
from prefect import flow

from conetl.cli.ingest import ingest_drives
from conetl.db.connection import connect, execute
from conetl.files.parquet_store import load_result
from conetl.files.storage import as_path
from conetl.geometry.motion.stereo_motion import RelativeMotion
from conetl.geometry.rig import right_camera_turned
from conetl.model.arrays import Image
from conetl.model.drive import FramePair, StereoMatch
from conetl.model.errors import InputError, ModelFileError
from conetl.model.params import IngestParams, TrajectoryParams
from conetl.model.rig import Side
from conetl.perception.rectified_image import read_pair_image
from conetl.pipeline import detect as detection
from conetl.pipeline.analysis import analyse
from conetl.pipeline.chunks import Chunk, chunks_of, parts_of
from conetl.pipeline.detect import NO_EXTRAS, Detected, ExtraSteps, detect, match
from conetl.pipeline.executor import ThreadExecutor
from conetl.pipeline.settings import Settings
from conetl.readers.drives import read_drive
from flows.artifacts import progress_artifact
from flows.tasks import PrefectExecutor, task_runner
from tests.cases import cases
from tests.dask_cluster import dask_workers
from tests.integration.small_drives import SAMPLES, cut_drive
from tests.mutants.recordings import Mutant, jump, turned
from tests.object_storage import BUCKET, object_storage


@pytest.fixture(scope="module")
def chunks(tmp_path_factory: pytest.TempPathFactory) -> list[Chunk]:
    drive, _ = read_drive(cut_drive(SAMPLES[0], tmp_path_factory.mktemp("drives") / "cut", "2026-04-01"))
    return chunks_of(drive, Settings(), IngestParams(chunk_pairs=2))  # each test sets its results_folder


@pytest.mark.parametrize("other", cases("processes", release=["dask"]))
def test_threads_and_others_write_the_same_bytes(
    other: str, prefect_here: Path, chunks: list[Chunk], tmp_path: Path
) -> None:
    drive, _ = read_drive(Path(chunks[0].frame_pairs[0].left_path).parents[2])
    heard: list[tuple[int, int]] = []

    def work(folder: Path) -> None:
        analyse(
            drive, chunks[0].params, settings=Settings(home=folder), executor=PrefectExecutor(),
            progress=progress_artifact("cut", lambda done, total: heard.append((done, total))),
        )  # fmt: skip

    written: dict[str, dict[str, bytes]] = {}
    for kind in ("threads", other):
        runner = task_runner(Settings(home=prefect_here, workers=1, task_runner=kind))
        assert cloudpickle.loads(cloudpickle.dumps(runner)) == runner  # a flow travels to its process with its runner
        heard.clear()
        flow(work, name=f"chunks by {kind}", validate_parameters=False).with_options(task_runner=runner)(
            tmp_path / kind
        )
        assert heard[-1] == (8, 8), "6 images and 2 motions, whoever counted them"
        others = [child.cmdline() for child in psutil.Process().children(recursive=True)]
        assert not [line for line in others if "prefect.server.api.server:create_app" in line], "shown on this server"
        written[kind] = {path.name: path.read_bytes() for path in (tmp_path / kind / "results").iterdir()}
    assert len(written["threads"]) == 16, (
        "3 of detections, 3 of image details, 3 of matches, 2 of a chunk's, 3 of motions, spans; self-calibration"
    )
    assert written[other] == written["threads"]


def test_matches_are_the_same_from_images_in_memory_and_read_again(chunks: list[Chunk], tmp_path: Path) -> None:
    written: list[dict[str, bytes]] = []
    for rig in (chunks[0].rig, right_camera_turned(chunks[0].rig, np.array([0.0, 1e-4, 0.0]))):
        chunk = chunks[0].model_copy(update={"results_folder": tmp_path / str(len(written))})
        parts = [detect(chunk, part, rig) for part in range(len(parts_of(chunk)))]
        assert len(list(chunk.results_folder.iterdir())) == 6, "matches by this rig come along with the detections"
        matches, _ = load_result(match(chunk, chunk.rig, *parts), StereoMatch)
        assert any(match.refined for match in matches)
        written.append({path.name: path.read_bytes() for path in chunk.results_folder.iterdir()})
    assert written[0].items() < written[1].items(), "also with those by the other rig"


def test_corrected_poses_find_again_what_their_images_showed(chunks: list[Chunk], tmp_path: Path) -> None:
    """Positions change neither detections nor matches, attitudes do: of the rows that are searched, and of the way up."""
    chunk = chunks[0].model_copy(update={"results_folder": tmp_path})
    found = detect(chunk, 0, chunk.rig)
    written = {path.name for path in tmp_path.iterdir()}

    def again(mutant: Mutant) -> Detected:
        drive = mutant(read_drive(Path(chunk.frame_pairs[0].left_path).parents[2])[0])
        return detect(chunk.model_copy(update={"frame_pairs": drive.frame_pairs[:2]}), 0, chunk.rig)

    assert again(jump(0.5, 0)) == found and {path.name for path in tmp_path.iterdir()} == written
    assert again(turned(0.0, 0.0, 2.0)) == found and len(list(tmp_path.iterdir())) == len(written) + 1
    assert again(turned(0.0, 3.0, 0.0)) != found


def test_what_is_found_along_with_detections_is_what_is_found_later(chunks: list[Chunk], tmp_path: Path) -> None:
    """Of images that were decoded for the detection, and of images that are read again."""
    written: list[dict[str, bytes]] = []
    everything, motions = ExtraSteps(odometry=True, markings=True), []
    for first in (everything, NO_EXTRAS):
        results = tmp_path / str(first.odometry)
        for chunk in (chunk.model_copy(update={"results_folder": results}) for chunk in chunks):
            for part in range(len(parts_of(chunk))):
                alone = detect(chunk, part, chunk.rig, first)
                found = detect(chunk, part, chunk.rig, everything)
                assert alone == (found if first is everything else Detected(found.detections))
                motions.append(load_result(found.motions, RelativeMotion)[0])
        written.append({path.name: path.read_bytes() for path in results.iterdir()})
    assert written[0] == written[1]
    at = [(each.first_frame_index, each.second_frame_index) for part in motions for each in part]
    pairs = [pair.frame_index for chunk in chunks for pair in chunk.frame_pairs]
    assert at == 2 * list(pairwise(pairs)), "the last motion is that to the next chunk"


@pytest.mark.parametrize("along", [NO_EXTRAS, ExtraSteps(odometry=True, markings=True)])
def test_images_are_decoded_once(along: ExtraSteps, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For detections and for what is found along with them; but for the pair to which the last motion leads."""
    chunk, *_ = chunks_of(read_drive(SAMPLES[0])[0], Settings(home=tmp_path), IngestParams(chunk_pairs=12))
    decoded: Counter[tuple[int, str]] = Counter()

    def counted(pair: FramePair, side: Side, *arguments: Any) -> Image:
        decoded[pair.frame_index, side] += 1
        return read_pair_image(pair, side, *arguments)

    monkeypatch.setattr(detection, "read_pair_image", counted)
    detect(chunk, 0, chunk.rig, along)
    assert set(decoded.values()) == {1}
    assert {index for index, _ in decoded} == set(range(6 + along.odometry))
    assert (len(decoded) == 14) is along.odometry, "detections leave some right images out"


@pytest.mark.parametrize(("most", "steps", "spans"), cases((50, 2, 38), release=[(10, 1, 10), (120, 1, 19)]))
def test_self_calibration_follows_spans_of_all_of_a_drive_or_of_pieces(
    most: int, steps: int, spans: int, sample_settings: Settings
) -> None:
    """The drive is 52 m long. The last case compares points over one metre."""
    drive, _ = read_drive(SAMPLES[0])
    few = TrajectoryParams(self_calibration_max_spans=most, self_calibration_span_m=1.0 if most == 50 else 2.0)
    heard = [(0, 0)]
    with ThreadExecutor(2) as executor:
        found = analyse(
            drive, IngestParams(chunk_pairs=8, trajectory=few), settings=sample_settings, executor=executor,
            progress=lambda done, total: heard.append((done, total)),
        )  # fmt: skip
        assert {time.step: time.task_count for time in executor.times()}["follow points"] == steps
    assert found.calibration.span_count == spans
    assert len(found.trajectory.frame_pairs) == 39 and found.trajectory.outcome == "refined"
    assert heard[-1] == (116, 116)


def test_another_machines_model_is_no_answer(chunks: list[Chunk], tmp_path: Path) -> None:
    other = chunks[0].model_copy(update={"results_folder": tmp_path, "detections_sha256": "0" * 64})
    with pytest.raises(ModelFileError, match="all machines need the same version"):
        detect(other, 0, other.rig)
    assert list(tmp_path.iterdir()) == []


def test_an_address_without_dask_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="CONETL_DASK_ADDRESS"):
        task_runner(Settings(home=tmp_path, dask_address="tcp://127.0.0.1:8786"))


@pytest.fixture
def storage() -> Iterator[str]:
    """Address of an empty bucket, which the environment leads to."""
    with object_storage():
        yield f"s3://{BUCKET}"


def kill_one(address: str, processes: dict[str, subprocess.Popen[bytes]], results: Path) -> dict[str, int]:
    """Kill a worker that searches for cones once a result is there; what was there then: file name and inode."""
    deadline = time.monotonic() + 120
    with Client(address) as client:
        while time.monotonic() < deadline:
            there = {path.name: path.stat().st_ino for path in results.glob("*.parquet")}
            names = {worker: info["name"] for worker, info in client.scheduler_info(n_workers=-1)["workers"].items()}
            for worker, keys in client.processing().items() if there else ():
                if any(str(key).startswith("detect") for key in keys):
                    processes[names[worker]].kill()
                    return there
            time.sleep(0.02)
    raise AssertionError("no worker was seen at work")


@pytest.mark.release
def test_a_drive_in_object_storage_makes_the_same_map_even_if_a_worker_of_dask_dies(
    prefect_here: Path, chunks: list[Chunk], database_url: str, storage: str, tmp_path: Path
) -> None:
    """A drive from disk by threads, and from storage by two workers, of which one is killed.

    The killed worker costs the chunk that it had: what was finished before is not computed again.
    """
    folder = Path(chunks[0].frame_pairs[0].left_path).parents[2]
    remote = as_path(f"{storage}/{folder.name}")
    remote.fs.put(f"{folder}/", f"{BUCKET}/{folder.name}/", recursive=True)  # type: ignore[attr-defined]
    features = []
    with dask_workers(tmp_path, 2) as (address, processes), ThreadPoolExecutor() as beside:
        for name, drive, dask in (
            ("disk", folder, {}),
            ("dask", Path(str(remote)), {"task_runner": "dask", "dask_address": address}),
        ):
            settings = Settings(home=prefect_here / name, map_name=name, database_url=database_url, **dask)  # type: ignore[arg-type]
            killed = beside.submit(kill_one, address, processes, settings.results_folder) if dask else None
            reports, code = ingest_drives(
                [drive], settings, IngestParams(chunk_pairs=1), map_srid=None, show=lambda _: None
            )
            assert (code, reports[0].status) == (0, "committed")
            with connect(database_url) as conn:
                features.append(
                    execute(
                        conn,
                        "select st_astext(geom) as at, existence_probability, object_height_m, observation_count "
                        "from conetl.feature_states(%(name)s, now()) order by 1",
                        {"name": name},
                    )
                )
        assert killed is not None
        before = killed.result()
        assert sum(process.poll() is not None for process in processes.values()) == 1
        after = {path.name: path.stat().st_ino for path in settings.results_folder.glob("*.parquet")}
    assert features[0] == features[1]
    assert features[0]
    assert {name: after[name] for name in before} == before
    assert len(after) > len(before)
