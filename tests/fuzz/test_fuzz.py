"""Every reader on its own valid files and on mutated ones: what it reads is as recorded in `recorded/`, and within limits.

Renew the records with CONETL_RENEW_RECORDED=1 and read the difference. `make fuzz` has the long run.
"""

from __future__ import annotations

import hashlib
import os
import random
from pathlib import Path

import pytest

from tests import recorded_text
from tests.fuzz.fuzz_readers import run_case, valid_files
from tests.fuzz.outcomes import case_lines, result_lines
from tests.fuzz.readers import READERS

FOLDER = Path(__file__).with_name("recorded")
CASES = 16
SEED = 1
#: Later cases with this seed that once crashed, hung, filled the memory, or quoted a whole file.
FOUND = {
    "plain": (124, 175, 1551, 2767, 3750, 9723), "euroc": (177, 200, 202, 220, 413, 529, 6233), "rig_opencv_xml": (40, 151),
    "rig_kalibr": (2003,), "rig_ros": (292, 341), "rig_matlab_mat": (6102,), "map_parquet": (85, 2105),
    "points_laz": (388, 812, 873, 891), "lanes_opendrive": (106, 137, 371, 2367, 8516), "lanes_geojson": (79, 142),
    "lanes_gpkg": (145,), "map_geojson": (44, 192), "map_csv": (189, 360, 383), "model_card": (807,), "odometry_bag": (2960,),
    "bag": (4210, 5444, 6669), "mcap_file": (495, 4535, 5646, 7141, 8777),
    "ros1_bag": (4717,), "video_search": (5679,),
}  # fmt: skip


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", READERS)
def test_files_are_read_as_recorded_and_mutated_ones_within_limits(name: str, tmp_path: Path) -> None:
    valid = valid_files(READERS[name], tmp_path)
    whole = result_lines(valid.found, tmp_path)
    path = FOLDER / f"{name}.txt"
    digest = hashlib.sha256(b"".join(valid.files.values())).hexdigest()
    entries = {"files": [digest[:16]], "valid": whole}
    for case in (*range(CASES), *FOUND.get(name, ())):
        outcome = run_case(READERS[name], valid, random.Random(f"{SEED}/{name}/{case}"))
        assert outcome.problem is None, f"case {case}"
        entries[f"case {case}"] = case_lines(outcome.found, whole, tmp_path)
    if os.environ.get("CONETL_RENEW_RECORDED"):
        recorded_text.write(path, entries)
    known = recorded_text.recorded(path)
    if known.get("files") != entries["files"]:  # another processor rounds their last digits, which mutations move
        entries = {"valid": whole}
    apart = {entry: recorded_text.differences(known.get(entry, []), lines) for entry, lines in entries.items()}
    assert {entry: lines for entry, lines in apart.items() if lines} == {}
