"""Settings of this machine: the only reader of environment variables (`CONETL_*`)."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable
from difflib import get_close_matches
from itertools import chain
from pathlib import Path
from typing import Literal
from urllib.parse import urlsplit

from pydantic import Field, SecretStr, ValidationError
from pydantic_settings import BaseSettings, SettingsConfigDict

from conetl.files.documents import expectation
from conetl.files.home import PREFECT_LOGIN, make_secret, read_secret
from conetl.files.names import file_name_part, printable
from conetl.files.storage import as_path, is_remote, links_of
from conetl.model.errors import InputError
from conetl.model.map_records import MAP_NAME

#: Variables that are not settings: of compose.yaml, of conetl's services, of tests, and those that Kubernetes sets for a service.
_NO_SETTING = re.compile(
    "CONETL_(VERSION|HOST|DRIVES|THREADS|SERVICE_TOKEN|SHARED_DATA|SCREENSHOTS|STREAMS|RENEW_(MESSAGES|PROMISE|RECORDED)|(.*_)?(SERVICE_HOST|PORT)(_.*)?)"
)


class Settings(BaseSettings):
    """Settings of one run. An environment variable sets each field, for example CONETL_DATABASE_URL."""

    model_config = SettingsConfigDict(env_prefix="CONETL_", frozen=True, extra="forbid")

    database_url: SecretStr | None = None
    """PostGIS database; default: a private cluster in `home`. Secret, because Prefect stores parameters."""
    home: Path = Path(".conetl")
    """Folder of the private database cluster, intermediate results, exports and Prefect's state."""
    map_name: str = Field(default="default", pattern=f"^{MAP_NAME.pattern}$")
    model_path: Path | None = None
    """ONNX file of the detector; default: the shipped one."""
    onnx_providers: str = "CPU"
    """Execution providers of the installed onnxruntime, the preferred one first, such as `CUDA,CPU`."""
    workers: int = Field(default=os.cpu_count() or 1, ge=1)
    """Number of parallel detection tasks, one core each; default: all cores."""
    task_runner: Literal["threads", "processes", "dask"] = "threads"
    """What processes the chunks of a drive; the results are equal."""
    dask_address: str | None = None
    """Scheduler of a Dask cluster for `task_runner` dask, such as tcp://host:8786; default: Dask on this machine."""

    drop_folder: Path | None = None
    """Folder in which new drives arrive, for the deployment `ingest-drop-folder`; default: `inbox` in `home`."""
    drive_roots: str = ""
    """Folders below which workers may read drives, also s3://bucket/, separated by commas; default: everywhere."""
    drop_quiet_minutes: float = Field(default=10.0, ge=0)
    """A drive without the file COMPLETE counts as complete if nothing in it has changed for this long."""
    prefect_database_url: SecretStr | None = None
    """Database of the Prefect server that `conetl up` starts; default: `prefect` on the server of the map."""
    drives_pool: str = "conetl"
    """Prefect's work pool of the deployment `ingest-drive`; by default drives run as processes."""
    notification_block: str = ""
    """Prefect's block that sends the notifications of the automations, as type/name, such as slack-webhook/operations."""
    webhooks: SecretStr | None = None
    """Addresses that get notices of work zones and differences from plans, separated by commas; `prefect`: events of Prefect."""
    webhook_secret: SecretStr | None = None
    """Secret with which these messages are signed."""
    prefect_hosts: str = ""
    """Other host names of the Prefect server, such as that of a proxy, separated by commas."""
    writer_token: SecretStr | None = None
    """Token with which the web view accepts decisions; see also `conetl view --writer-token-file`."""
    images: Literal["crop", "full"] = "crop"
    """Images in the view, reports and Prefect: crop pixelates all but detections and their surroundings."""
    embed_host: str | None = Field(default=None, pattern=r"^https?://[A-Za-z0-9.-]+(:\d{1,5})?$")
    """Server whose pages may show the map viewer's `embed.html` in a frame, such as https://intranet.example; default: none."""
    view_url: str | None = None
    """Address of `conetl view`, for links in Prefect; `conetl up` sets it for its workers."""

    @property
    def inbox(self) -> Path:
        return self.drop_folder or self.home / "inbox"

    @property
    def receipts_folder(self) -> Path:
        return self.home / "receipts"

    @property
    def results_folder(self) -> Path:
        return self.home / "results"

    @property
    def images_folder(self) -> Path:
        """Images unpacked from bags, by the hash of their bytes; may be deleted while nothing runs."""
        return self.home / "images"

    @property
    def exports_folder(self) -> Path:
        return self.home / "exports"

    @property
    def reports_folder(self) -> Path:
        """QA reports of this map."""
        return self.exports_folder / "reports" / self.map_name

    def require_readable(self, path: Path, *, links: bool = False) -> None:
        """Raise InputError for a drive or folder of drives outside of `drive_roots`; links are followed first.

        links: also for one of whose links one leads there; to be called where the drive is read, right before that.
        """
        roots = [as_path(root.strip()) for root in self.drive_roots.split(",") if root.strip()]
        if not roots:
            return
        real_roots = [root if is_remote(root) else root.resolve() for root in roots]
        for found in chain([path], links_of(path) if links else ()):  # each before the search follows it
            real = found if is_remote(found) else Path(os.path.realpath(found))  # also of a link to itself
            if ".." in real.parts or not any(root == real or root in real.parents for root in real_roots):
                raise InputError(
                    f"{printable(found)} lies outside of the folders that workers may read ({', '.join(map(str, roots))}): set "
                    "CONETL_DRIVE_ROOTS for `conetl up`, or ingest it with `conetl ingest` or `conetl backfill --here`"
                )

    def drive_report_path(self, drive_id: str, changeset_no: int) -> Path:
        """Path of the QA report of a drive."""
        return self.reports_folder / f"{changeset_no:06d}-{file_name_part(drive_id, 120)}.html"

    def drive_image_path(self, drive_id: str) -> Path:
        """Path of the plan view of a drive and its changes on this map."""
        return self.reports_folder / f"{file_name_part(drive_id, 120)}.png"


def validated_map_name(name: str) -> str:
    """The name, if it is valid for a map. Raises InputError."""
    if not MAP_NAME.fullmatch(name):
        raise InputError(f"invalid map name {name!r}: {_expected_map_name(name)}")
    return name


def _expected_map_name(name: str) -> str:
    """The rules for map names, and the nearest valid name. One case only: names are parts of paths, which may ignore case."""
    near = re.sub("[^a-z0-9_-]+", "_", name.lower())[:40].strip("_-")
    return f"expected 1 to 40 characters of a-z, 0-9, _ and -, the first not -, for example {near or 'night_survey'}"


def read_settings(map_name: str | None = None) -> Settings:
    """Settings from the environment; map_name overrides CONETL_MAP_NAME. Raises InputError naming the invalid variable."""
    try:
        return Settings() if map_name is None else Settings(map_name=validated_map_name(map_name))
    except ValidationError as error:
        first = error.errors()[0]
        name = f"CONETL_{'_'.join(str(part) for part in first['loc']).upper()}"
        wanted = _expected_map_name(str(first["input"])) if first["loc"] == ("map_name",) else expectation(first)
        raise InputError(f"the environment variable {name} is {first['input']!r}: {wanted}") from error


def ignored_variables(names: Iterable[str]) -> list[str]:
    """Environment variables (of `names`) that look like settings but are not, with the setting that may be meant."""
    known = [f"CONETL_{name.upper()}" for name in Settings.model_fields]
    unknown = [n for n in names if n.startswith("CONETL_") and n not in known and not _NO_SETTING.fullmatch(n)]
    near = {name: get_close_matches(name, known, n=1, cutoff=0.7) for name in unknown}
    return [name + "".join(f" (did you mean {other}?)" for other in near[name]) for name in sorted(unknown)]


def prefect_environment(home: Path) -> dict[str, str]:
    """Environment variables for Prefect that the caller sets: defaults of those that are not set, and NO_PROXY.

    Prefect's own state is under `home`; no analytics are sent; only warnings are logged. No proxy is used for loopback addresses.
    """
    defaults = {
        "PREFECT_HOME": str((home / "prefect").resolve()),
        "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
        "DO_NOT_TRACK": "1",
        "PREFECT_LOGGING_LEVEL": "WARNING",
        # What conetl logs is shown with the flow run in which it is logged; outside of a run nothing is sent.
        "PREFECT_LOGGING_EXTRA_LOGGERS": "conetl,flows",
        "PREFECT_LOGGING_ROOT_LEVEL": "INFO",  # of these loggers too; they have no level of their own
        "PREFECT_LOGGING_TO_API_WHEN_MISSING_FLOW": "ignore",
        # The server keeps warnings and tracebacks; the terminal shows the one sentence of the command.
        "PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL": "CRITICAL",
        "PREFECT_SERVER_LOGGING_LEVEL": "ERROR",
        "PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS": "60",
        # States of task runs are written together, once a second: one by one they cost as much as everything else.
        "PREFECT_SERVER_SERVICES_TASK_RUN_RECORDER_BATCH_SIZE": "100",
        "PREFECT_SERVER_SERVICES_TASK_RUN_RECORDER_FLUSH_INTERVAL": "1",
        # Runs with their logs and artifacts go after 90 days: a drive leaves 1 MB of them, and the map has its own receipts.
        "PREFECT_SERVER_SERVICES_DB_VACUUM_ENABLED": "events,flow_runs",
    }
    # The name in lower case takes precedence where a program reads both.
    direct = [os.environ.get("no_proxy") or os.environ.get("NO_PROXY", ""), "localhost", "127.0.0.1"]
    proxies = dict.fromkeys(("no_proxy", "NO_PROXY"), ",".join(host for host in direct if host))
    return {name: value for name, value in defaults.items() if name not in os.environ} | proxies


#: Login that a Prefect server requires of its clients, user:password; Prefect's name of the variable.
SERVER_AUTH = "PREFECT_SERVER_API_AUTH_STRING"


def prefect_login(home: Path) -> str:
    """user:password of the Prefect server that conetl starts: SERVER_AUTH, PREFECT_API_AUTH_STRING, or of a file in `home`.

    The file is made when it is needed and missing. Only for conetl's own server: where PREFECT_API_URL names another, Prefect
    reads PREFECT_API_AUTH_STRING itself. Raises InputError if others may read the file.
    """
    given = os.environ.get(SERVER_AUTH) or os.environ.get("PREFECT_API_AUTH_STRING")
    return given or read_secret(make_secret(home / PREFECT_LOGIN, "conetl:")).get_secret_value()


def prefect_server_environment(home: Path, address: str) -> dict[str, str]:
    """Environment variables of a Prefect server of conetl: its login, and pages of its own address only.

    address: URL by which browsers call it. By default Prefect allows pages of every origin.
    """
    page = os.environ.get("PREFECT_SERVER_UI_API_URL", f"{address}/api")
    origin = urlsplit(page)
    return {
        SERVER_AUTH: prefect_login(home),
        "PREFECT_SERVER_UI_API_URL": page,
        "PREFECT_SERVER_CORS_ALLOWED_ORIGINS": f"{origin.scheme}://{origin.netloc}",
    }
