"""What is said where PostGIS is missing, and which server is taken where there are several."""

from __future__ import annotations

from pathlib import Path

import pytest

from conetl.db.cluster.postgres_install import PostgresInstall, choose_install, probe_install
from conetl.model.errors import EXIT_SERVICE_MISSING, DatabaseError

BARE_14 = PostgresInstall(Path("/usr/lib/postgresql/14/bin"), (14, 2), ("postgis",))
FULL_15 = PostgresInstall(Path("/usr/lib/postgresql/15/bin"), (15, 10), ())
FULL_16 = PostgresInstall(Path("/usr/lib/postgresql/16/bin"), (16, 1), ())
BARE_17 = PostgresInstall(Path("/usr/lib/postgresql/17/bin"), (17, 0), ("postgis", "btree_gist"))


@pytest.mark.parametrize(
    ("installs", "data_major", "package"),
    [
        ([], None, "postgresql-postgis"),
        ([BARE_17, BARE_14], None, "postgresql-17-postgis-3"),
        ([FULL_16], 15, "postgresql-15-postgis-3"),
        ([BARE_14], 14, "postgresql-14-postgis-3"),
    ],
)
def test_one_sentence_names_the_package_and_the_way_round(installs, data_major, package):
    with pytest.raises(DatabaseError) as caught:
        choose_install(installs, data_major=data_major)
    text = str(caught.value)
    assert f"apt-get install {package}`" in text
    assert "CONETL_DATABASE_URL" in text
    assert "\n" not in text
    assert caught.value.exit_code == EXIT_SERVICE_MISSING


def test_the_newest_with_postgis_is_taken_and_old_data_keep_their_version():
    installs = [BARE_17, FULL_16, FULL_15]
    assert choose_install(installs, data_major=None) is FULL_16
    assert choose_install(installs, data_major=15) is FULL_15


def test_a_folder_without_all_programs_is_no_server(tmp_path):
    assert probe_install(tmp_path) is None
    (tmp_path / "postgres").write_text("")
    assert probe_install(tmp_path / "missing") is None
