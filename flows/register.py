"""Registers the work pool, the deployments and the automations of `conetl up`."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from contextlib import suppress
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any
from uuid import UUID

import yaml
from prefect.client.schemas.actions import WorkPoolCreate, WorkPoolUpdate
from prefect.client.schemas.objects import WorkerStatus
from prefect.events import AutomationCore
from prefect.exceptions import ObjectAlreadyExists, ObjectNotFound
from prefect.variables import Variable

from conetl.model.errors import ServiceError
from conetl.pipeline.settings import read_settings
from flows.dispatch import POOL
from flows.runs import BACKFILL_QUEUE, client

_VARIABLE = "conetl_deployments"
_TIMEOUT_S = 300
AUTOMATIONS = Path(__file__).with_name("automations.yaml")
#: Templates of Prefect. A trigger that misses an event has none.
_SUBJECT = "{{ automation.name }}"
_BODY = (
    "{{ automation.description }}{% if event %} {{ event.resource.name or event.resource.id }}: "
    "{{ event.payload.reason or event.payload.on_hold or event.resource['prefect.state-message'] or '' }}{% endif %}"
)
#: Whoever starts a run chooses its parameters only: no command, environment or working folder as in Prefect's own template.
JOB_TEMPLATE: dict[str, Any] = {
    "job_configuration": {"stream_output": True},
    "variables": {"type": "object", "properties": {}, "additionalProperties": False},
}


def deployments_file() -> Path:
    """Path of `prefect.yaml`: beside the flows in an installed wheel, at the top of a clone."""
    package = Path(__file__).resolve().parent
    return next(path for path in (package / "prefect.yaml", package.parent / "prefect.yaml") if path.is_file())


def ensure_pool() -> None:
    """Create the work pool, or bring its job template up to date; other changes made in the UI are kept."""
    with client() as api:
        try:
            api.create_work_pool(
                WorkPoolCreate(
                    name=POOL, type="process", description="Machines that run conetl", base_job_template=JOB_TEMPLATE
                )
            )
        except ObjectAlreadyExists:
            api.update_work_pool(POOL, WorkPoolUpdate(base_job_template=JOB_TEMPLATE))


def ensure_deployments() -> bool:
    """Register the deployments of `prefect.yaml`, and the automations, unless this version is registered.

    Changes in the UI are kept until an upgrade, or until the settings change. Returns whether they were registered now.
    Raises ServiceError with Prefect's message, or where the notification block is missing.
    """
    path, settings = deployments_file(), read_settings()
    pool, block = settings.drives_pool, _notification_block(settings.notification_block)
    files = hashlib.sha256(path.read_bytes() + AUTOMATIONS.read_bytes()).hexdigest()
    wanted = f"{version('conetl')} {files} {pool} {block}"
    with client() as api:
        registered = {deployment.name for deployment in api.read_deployments()}
    if Variable.get(_VARIABLE) == wanted and "ingest-drive" in registered:
        return False
    done = subprocess.run(
        [sys.executable, "-m", "prefect", "--no-prompt", "deploy", "--all", "--prefect-file", str(path)],
        capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL, timeout=_TIMEOUT_S, cwd=path.parent,
        env={**os.environ, "CONETL_DRIVES_POOL": pool, "PREFECT_LOGGING_LEVEL": "ERROR"},
    )  # fmt: skip
    if done.returncode != 0:
        raise ServiceError(
            f"the deployments of {path} could not be registered: {(done.stderr or done.stdout).strip()[-1500:]}"
        )
    with client() as api, suppress(ObjectAlreadyExists):
        # A worker gets nothing at all while one of its queues is missing. Made last, it comes behind that of the deployment.
        api.create_work_queue(name=BACKFILL_QUEUE, work_pool_name=pool)
    _ensure_automations(block)
    Variable.set(_VARIABLE, wanted, overwrite=True)
    return True


def _notification_block(name: str) -> UUID | None:
    """Id of the block, named as type/name, which sends notifications; None where none is named. Raises ServiceError."""
    type_slug, _, block_name = name.partition("/")
    with client() as api:
        try:
            return api.read_block_document_by_name(block_name, type_slug).id if name else None
        except ObjectNotFound:
            raise ServiceError(
                f"CONETL_NOTIFICATION_BLOCK: this Prefect server has no block {name}; make it in Prefect's UI (Blocks), and "
                "name it as type/name, such as slack-webhook/operations"
            ) from None


def _ensure_automations(block: UUID | None) -> None:
    """Create the automations of `automations.yaml`, or bring them up to date; one that a person has paused stays so.

    block: which sends the notifications; None: the automations do nothing but write an event.
    """
    action: dict[str, Any] = {"type": "do-nothing"}
    if block is not None:
        action = {"type": "send-notification", "block_document_id": block, "subject": _SUBJECT, "body": _BODY}
    with client() as api:
        for wanted in yaml.safe_load(AUTOMATIONS.read_text(encoding="utf-8")):
            automation = AutomationCore.model_validate(wanted | {"actions": [action]})
            present = api.read_automations_by_name(automation.name)
            if present:
                api.update_automation(present[0].id, automation.model_copy(update={"enabled": present[0].enabled}))
            else:
                api.create_automation(automation)


def worker_is_online(name: str, since: datetime) -> bool:
    """Whether a worker of this name has sent a heartbeat since then."""
    with client() as api:
        workers = api.read_workers_for_work_pool(POOL)
    return any(
        w.name == name and w.status == WorkerStatus.ONLINE and w.last_heartbeat_time and w.last_heartbeat_time >= since
        for w in workers
    )  # fmt: skip
