"""compose.yaml, its image and prefect.yaml, checked without running containers."""

from __future__ import annotations

import importlib
import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml

from flows.register import JOB_TEMPLATE
from flows.runs import BACKFILL_QUEUE, FLOWS
from tests.folders import ROOT

COMPOSE = yaml.safe_load((ROOT / "compose.yaml").read_text(encoding="utf-8"))
PREFECT = yaml.safe_load((ROOT / "prefect.yaml").read_text(encoding="utf-8"))


def test_services_wait_for_services_that_exist() -> None:
    services: dict[str, Any] = COMPOSE["services"]
    assert {"postgis", "prefect", "desk", "drives", "view"} <= set(services)
    for name, service in services.items():
        for other, how in service.get("depends_on", {}).items():
            assert other in services, f"{name} waits for {other}"
            if how["condition"] == "service_healthy":
                assert "healthcheck" in services[other], f"{other} has no healthcheck"


def test_every_variable_is_explained_at_the_top_or_has_a_default() -> None:
    text = (ROOT / "compose.yaml").read_text(encoding="utf-8")
    head = text[: text.index("name: conetl")]
    for variable, default in re.findall(r"(?<!\$)\$\{([A-Z_]+)(:-[^}]*)?", text):
        assert default or variable in head, f"{variable} is not explained at the top of compose.yaml"


def test_commands_in_python_import_what_exists() -> None:
    commands = [str(part) for service in COMPOSE["services"].values() for part in service.get("command", [])]
    imports = [found for command in commands for found in re.findall(r"from ([\w.]+) import (\w+)", command)]
    assert len(imports) >= 2
    for module, name in imports:
        assert hasattr(importlib.import_module(module), name) or importlib.util.find_spec(f"{module}.{name}")


def test_no_secret_stands_in_a_definition() -> None:
    for name, service in COMPOSE["services"].items():
        for key, value in service.get("environment", {}).items():
            secret = re.search(r"PASSWORD|AUTH", key) and not key.endswith(("_FILE", "_HASH"))
            assert not secret, f"{name}: {key}"
            assert not re.search(r"://[^/@]*:[^/@]*@", str(value)), f"{name}: {key}"


def test_only_the_proxy_is_reached_from_outside() -> None:
    """The view shares the proxy's network, but listens on loopback only."""
    services: dict[str, Any] = COMPOSE["services"]
    assert [name for name, service in services.items() if "ports" in service] == ["network"]
    inside = [name for name, service in services.items() if service.get("network_mode") == "service:network"]
    assert inside == ["view", "proxy"]


def test_the_image_can_be_built_beside_the_secrets_and_does_not_hold_them() -> None:
    left_out = (ROOT / ".dockerignore").read_text(encoding="utf-8").splitlines()
    for secret in COMPOSE["secrets"].values():
        assert Path(secret["file"]).parts[0] in left_out
    assert {".env", ".git"} <= set(left_out)
    assert {"/.env", "/secrets/"} <= set((ROOT / ".gitignore").read_text(encoding="utf-8").splitlines())


def test_pages_of_prefect_can_be_written_and_are_in_no_volume() -> None:
    prefect: dict[str, Any] = COMPOSE["services"]["prefect"]
    folder = Path(prefect["environment"]["PREFECT_SERVER_UI_STATIC_DIRECTORY"])
    assert folder.parent == Path("/tmp")
    volumes = [Path(volume.split(":")[1]) for volume in prefect["volumes"] if volume.count("/") and "$" not in volume]
    assert volumes
    assert not any(volume in folder.parents for volume in volumes)


def test_the_entry_point_hands_secrets_over_and_becomes_the_command(tmp_path: Path) -> None:
    secrets = tmp_path / "secrets"
    secrets.mkdir()
    (secrets / "ONE").write_text("a 'b' $c=d\n", encoding="utf-8")
    script = tmp_path / "with_secrets.sh"
    text = (ROOT / "scripts/with_secrets.sh").read_text(encoding="utf-8")
    script.write_text(text.replace("/run/secrets", str(secrets)), encoding="utf-8")
    script.chmod(0o755)
    show = "import os; print(os.getpid(), os.environ['ONE'])"
    with subprocess.Popen([script, sys.executable, "-c", show], stdout=subprocess.PIPE, text=True) as process:
        said, _ = process.communicate(timeout=60)
    assert said == f"{process.pid} a 'b' $c=d\n"


def test_every_deployment_is_recovered_after_a_crash() -> None:
    assert {deployment["name"] for deployment in PREFECT["deployments"]} == set(FLOWS)


def test_deployments_name_flows_that_exist_and_queues_that_workers_serve() -> None:
    workers = {name: str(COMPOSE["services"][name]["command"]) for name in ("desk", "drives")}
    for deployment in PREFECT["deployments"]:
        module, function = deployment["entrypoint"].rsplit(".", 1)
        assert hasattr(importlib.import_module(module), function)
        queue = deployment["work_pool"]["work_queue_name"]
        assert f"--work-queue {queue} " in workers[queue]
        assert "concurrency_limit" not in deployment, "the run would crash when Prefect's server restarts"
    assert f"--work-queue {BACKFILL_QUEUE} " in workers["drives"]


def test_a_container_per_drive_finds_what_compose_has() -> None:
    template = json.loads((ROOT / "deploy/docker/pool.json").read_text(encoding="utf-8"))
    assert template["variables"] == JOB_TEMPLATE["variables"], "whoever starts a run chooses its parameters only"
    job, drives = template["job_configuration"], COMPOSE["services"]["drives"]
    assert job["networks"] == [f"{COMPOSE['name']}_default"]
    assert job["volumes"][0] == f"{COMPOSE['name']}_{drives['volumes'][0]}"
    targets = {volume.split(":")[1] for volume in job["volumes"]}
    assert {f"/run/secrets/{secret['target']}" for secret in drives["secrets"]} <= targets
    for name in ("CONETL_HOME", "CONETL_DATABASE_URL", "PREFECT_API_URL", "PREFECT_CLIENT_RETRY_EXTRA_CODES"):
        assert job["env"][name] == drives["environment"][name]


def test_runs_survive_a_restart_of_the_database_behind_prefect() -> None:
    """Its API answers 500 meanwhile, which its clients do not try again by themselves."""
    for name in ("register", "desk", "drives"):
        assert COMPOSE["services"][name]["environment"]["PREFECT_CLIENT_RETRY_EXTRA_CODES"] == "500"


def test_workers_have_time_to_end() -> None:
    for name in ("desk", "drives"):
        assert COMPOSE["services"][name]["stop_grace_period"] == "2m"


def test_forms_describe_what_a_person_may_set() -> None:
    for deployment in PREFECT["deployments"]:
        module, function = deployment["entrypoint"].rsplit(".", 1)
        schema = getattr(importlib.import_module(module), function).parameters.model_dump()
        fields = [*schema["properties"].items()]
        fields += [field for group in schema["definitions"].values() for field in group.get("properties", {}).items()]
        assert [name for name, field in fields if not field.get("description")] == [], deployment["name"]
