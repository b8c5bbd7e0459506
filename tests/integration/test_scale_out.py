"""The same drive by threads, processes and Dask, and from object storage: one Prefect server for all of them."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path

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
from conetl.geometry.motion.stereo_tracks import StereoTracks
from conetl.geometry.rig import right_camera_turned
from conetl.model.drive import StereoMatch
from conetl.model.errors import InputError, ModelFileError
from conetl.model.params import IngestParams, TrajectoryParams
from conetl.pipeline.analysis import analyse
from conetl.pipeline.chunks import Chunk, chunks_of, parts_of
from conetl.pipeline.detect import NOTHING, Along, Detected, detect, match
from conetl.pipeline.executor import ThreadExecutor
from conetl.pipeline.markings import marking_points
from conetl.pipeline.odometry import odometry
from conetl.pipeline.settings import Settings
from conetl.readers.drives import read_drive
from flows.artifacts import progress_artifact
from flows.tasks import PrefectExecutor, task_runner
from tests.dask_cluster import dask_workers
from tests.integration.small_drives import SAMPLES, cut_drive
from tests.mutants.recordings import Mutant, jump, turned
from tests.object_storage import BUCKET, object_storage


@pytest.fixture(scope="module")
def chunks(tmp_path_factory: pytest.TempPathFactory) -> list[Chunk]:
    drive, _ = read_drive(cut_drive(SAMPLES[0], tmp_path_factory.mktemp("drives") / "cut", "2026-04-01"))
    return chunks_of(drive, Settings(), IngestParams(chunk_pairs=2))  # each test sets its results_folder


def test_threads_processes_and_dask_write_the_same_bytes(
    prefect_here: Path, chunks: list[Chunk], tmp_path: Path
) -> None:
    drive, _ = read_drive(Path(chunks[0].frame_pairs[0].left_path).parents[2])
    heard: list[tuple[int, int]] = []

    def work(folder: Path) -> None:
        analyse(
            drive, chunks[0].params, settings=Settings(home=folder), executor=PrefectExecutor(),
            progress=progress_artifact("cut", lambda done, total: heard.append((done, total))),
        )  # fmt: skip

    written: dict[str, dict[str, bytes]] = {}
    for kind in ("threads", "processes", "dask"):
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
    assert len(written["threads"]) == 23, (
        "3 of detections, 3 of image details, 3 of matches, 2 of a chunk's, 2 of positions, 3 of points followed, 3 of motions, "
        "3 of spans; self-calibration"
    )
    assert written["processes"] == written["threads"]
    assert written["dask"] == written["threads"]


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


def test_what_is_found_along_with_detections_is_what_its_own_step_finds(chunks: list[Chunk], tmp_path: Path) -> None:
    written: list[dict[str, bytes]] = []
    for along in (Along(odometry=True, markings=True), NOTHING):
        chunk = chunks[0].model_copy(update={"results_folder": tmp_path / str(along.odometry)})
        for part in range(len(parts_of(chunk))):
            found = detect(chunk, part, chunk.rig, along)
            apart = found._replace(
                odometry=odometry(chunk, part),
                marking_points=marking_points(chunk, part, chunk.rig),
            )
            assert found == (apart if along.odometry else Detected(found.detections))
        written.append({path.name: path.read_bytes() for path in chunk.results_folder.iterdir()})
    assert written[0] == written[1]  # both with the spans of self-calibration, from `odometry`
    points = [load_result(odometry(chunk, part).tracks, StereoTracks)[0] for part in range(len(parts_of(chunk)))]
    at = [(each.first_frame_index, each.second_frame_index) for part in points for each in part]
    pairs = [pair.frame_index for other in chunks for pair in other.frame_pairs]
    assert at == list(pairwise(pairs)), "the last motion is that to the next chunk"


@pytest.mark.parametrize(("chunk_pairs", "steps"), [(8, 5), (6, 14)])
def test_self_calibration_follows_a_part_of_a_drive_or_all_where_that_shows_too_little(
    chunk_pairs: int, steps: int, tmp_path: Path
) -> None:
    """Parts of four motions hold a span of two metres each, not all of those of three do."""
    drive, _ = read_drive(SAMPLES[0])
    few = TrajectoryParams(self_calibration_max_spans=10)
    settings, heard = Settings(home=tmp_path), [(0, 0)]
    with ThreadExecutor(2) as executor:
        found = analyse(
            drive, IngestParams(chunk_pairs=chunk_pairs, trajectory=few), settings=settings, executor=executor,
            progress=lambda done, total: heard.append((done, total)),
        )  # fmt: skip
        assert {time.step: time.task_count for time in executor.times()}["odometry"] == steps
    assert found.calibration.span_count >= 8
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


def test_a_drive_in_object_storage_makes_the_same_map_even_if_a_worker_of_dask_dies(
    prefect_here: Path, chunks: list[Chunk], database_url: str, storage: str, tmp_path: Path
) -> None:
    """Drives from disk by threads, from storage by threads, and from storage by two workers, of which one is killed.

    The killed worker costs the chunk that it had: what was finished before is not computed again.
    """
    folder = Path(chunks[0].frame_pairs[0].left_path).parents[2]
    remote = as_path(f"{storage}/{folder.name}")
    remote.fs.put(f"{folder}/", f"{BUCKET}/{folder.name}/", recursive=True)  # type: ignore[attr-defined]
    features = []
    with dask_workers(tmp_path, 2) as (address, processes), ThreadPoolExecutor() as beside:
        for name, drive, dask in (
            ("disk", folder, {}),
            ("storage", Path(str(remote)), {}),
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
                        "select st_astext(geom) as at, existence_probability, cone_height_m, observation_count "
                        "from conetl.map_as_of(%(name)s, now()) order by 1",
                        {"name": name},
                    )
                )
        assert killed is not None
        before = killed.result()
        assert sum(process.poll() is not None for process in processes.values()) == 1
        after = {path.name: path.stat().st_ino for path in settings.results_folder.glob("*.parquet")}
    assert features[0] == features[1] == features[2]
    assert features[0]
    assert {name: after[name] for name in before} == before
    assert len(after) > len(before)
