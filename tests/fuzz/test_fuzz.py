"""A short run of the fuzzer with fixed cases; `make fuzz` has the long one."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from tests.fuzz.fuzz_readers import run_case, valid_files
from tests.fuzz.readers import READERS

CASES = 8
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
def test_mutated_files_give_a_result_a_rejection_or_an_error_of_conetl(name: str, tmp_path: Path) -> None:
    valid = valid_files(READERS[name], tmp_path)
    cases = [*range(CASES), *FOUND.get(name, ())]
    problems = {case: run_case(READERS[name], valid, random.Random(f"{SEED}/{name}/{case}"))[1] for case in cases}
    assert {case: problem for case, problem in problems.items() if problem} == {}
