"""deploy/kubernetes: rendered as kustomize does, checked against the schemas of Kubernetes, and against what it names."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml

from conetl.files.storage import as_path
from conetl.pipeline.settings import Settings
from flows.register import JOB_TEMPLATE
from tests.folders import ROOT

BASE = ROOT / "deploy" / "kubernetes"
VERSION = "1.31"
CLUSTER_WIDE = {"Namespace"}


def render(folder: Path) -> list[dict[str, Any]]:
    """The objects of a kustomization: resources, namespace, images and merge patches, which is all that ours use."""
    kustomization = yaml.safe_load((folder / "kustomization.yaml").read_text(encoding="utf-8"))
    assert set(kustomization) <= {"apiVersion", "kind", "namespace", "images", "resources", "patches"}
    objects: list[dict[str, Any]] = []
    for resource in kustomization["resources"]:
        path = (folder / resource).resolve()
        objects += render(path) if path.is_dir() else yaml.safe_load_all(path.read_text(encoding="utf-8"))
    images = {image["name"]: f"{image['newName']}:{image['newTag']}" for image in kustomization["images"]}
    for found in objects:
        if found["kind"] not in CLUSTER_WIDE:
            found["metadata"]["namespace"] = kustomization["namespace"]
        for container in containers(found):
            container["image"] = images.get(container["image"], container["image"])
    for patch in map(yaml.safe_load, (entry["patch"] for entry in kustomization.get("patches", []))):
        (target,) = (
            o for o in objects if (o["kind"], o["metadata"]["name"]) == (patch["kind"], patch["metadata"]["name"])
        )
        merge(target, patch)
    return objects


def merge(target: dict[str, Any], patch: dict[str, Any]) -> None:
    for key, value in patch.items():
        if isinstance(value, dict):
            merge(target.setdefault(key, {}), value)
        else:
            target[key] = value


def pods(*objects: dict[str, Any]) -> list[dict[str, Any]]:
    return [found["spec"]["template"]["spec"] for found in objects if found["kind"] in ("Deployment", "Job")]


def containers(*objects: dict[str, Any]) -> list[dict[str, Any]]:
    return [c for pod in pods(*objects) for c in (*pod.get("initContainers", []), *pod["containers"])]


def job_of_a_drive(objects: list[dict[str, Any]]) -> dict[str, Any]:
    (text,) = (o["data"]["pool.json"] for o in objects if o["metadata"]["name"] == "pool-template")
    template = json.loads(text)
    assert template["variables"] == JOB_TEMPLATE["variables"], "whoever starts a run chooses its parameters only"
    job: dict[str, Any] = template["job_configuration"]["job_manifest"]
    misplaced = [job["spec"]["template"]["spec"].pop(name) for name in ("completions", "parallelism")]
    assert misplaced == [1, 1], "Prefect's worker refuses a Job without them"
    return job


@pytest.fixture(params=[BASE, BASE / "pool"], ids=["processes", "jobs"])
def objects(request: pytest.FixtureRequest) -> list[dict[str, Any]]:
    found = render(request.param)
    return found if request.param == BASE else [*found, job_of_a_drive(found)]


def test_objects_are_of_the_schemas_of_kubernetes(objects: list[dict[str, Any]]) -> None:
    for found in objects:
        kubernetes_validate.validate(found, VERSION, strict=True)


def test_pods_run_without_rights_and_name_what_exists(objects: list[dict[str, Any]]) -> None:
    names = {(o["kind"], o["metadata"].get("name")) for o in objects}
    assert len(pods(*objects)) >= 5
    for pod in pods(*objects):
        assert pod["securityContext"]["runAsNonRoot"]
        assert (
            pod.get("automountServiceAccountToken") is False or ("ServiceAccount", pod["serviceAccountName"]) in names
        )
        volumes = {volume["name"]: volume for volume in pod["volumes"]}
        for volume in volumes.values():
            if "persistentVolumeClaim" in volume:
                assert ("PersistentVolumeClaim", volume["persistentVolumeClaim"]["claimName"]) in names
            if "configMap" in volume:
                assert ("ConfigMap", volume["configMap"]["name"]) in names
    for container in containers(*objects):
        assert container["image"].count(":") == 1, "a tag, never latest"
        assert container["resources"]["requests"]["memory"]
        assert container["resources"]["limits"]["memory"]
        assert container["securityContext"]["readOnlyRootFilesystem"]
        assert container["securityContext"]["capabilities"] == {"drop": ["ALL"]}


def test_probes_and_services_name_ports_and_pods_that_exist(objects: list[dict[str, Any]]) -> None:
    for container in containers(*objects):
        ports = {port["name"] for port in container.get("ports", [])}
        for probe in ("startupProbe", "readinessProbe", "livenessProbe"):
            assert probe not in container or container[probe]["httpGet"]["port"] in ports
    labels = [o["spec"]["template"]["metadata"]["labels"] for o in objects if o["kind"] in ("Deployment", "Job")]
    for found in objects:
        if found["kind"] == "Deployment":
            assert (
                found["spec"]["selector"]["matchLabels"].items()
                <= found["spec"]["template"]["metadata"]["labels"].items()
            )
        selector = (
            found["spec"].get("podSelector" if found["kind"] == "NetworkPolicy" else "selector")
            if "spec" in found
            else None
        )
        if found["kind"] in ("Service", "NetworkPolicy", "PodDisruptionBudget"):
            wanted = selector.get("matchLabels", selector)
            assert any(wanted.items() <= of_pod.items() for of_pod in labels), found["metadata"]["name"]


def test_variables_are_settings_and_no_secret_stands_in_a_file(objects: list[dict[str, Any]]) -> None:
    assert not any(found["kind"] == "Secret" for found in objects)
    (shared,) = (o["data"] for o in objects if (o["kind"], o["metadata"].get("name")) == ("ConfigMap", "conetl"))
    given = [
        *shared,
        *(variable["name"] for c in containers(*objects) for variable in c.get("env", []) if "value" in variable),
    ]
    for name in given:
        assert not name.startswith("CONETL_") or name.removeprefix("CONETL_").lower() in Settings.model_fields
        assert name not in ("PGPASSWORD", "CONETL_DATABASE_URL", "AWS_SECRET_ACCESS_KEY")
        assert not name.startswith("PREFECT_") or not name.endswith(("AUTH_STRING", "CONNECTION_URL"))


def test_drives_have_one_pool_and_its_jobs_the_image_of_the_others() -> None:
    base, jobs = render(BASE), render(BASE / "pool")
    replicas = {o["metadata"]["name"]: o["spec"]["replicas"] for o in jobs if o["kind"] == "Deployment"}
    assert replicas["drives"] == 0
    assert replicas["jobs"] == 1
    (pool,) = (
        o["data"]["CONETL_DRIVES_POOL"] for o in jobs if (o["kind"], o["metadata"]["name"]) == ("ConfigMap", "conetl")
    )
    commands = [" ".join(container["command"]) for container in containers(*jobs)]
    assert any(f"work-pool create {pool} " in command for command in commands)
    assert any(f"worker start --pool {pool} " in command for command in commands)
    (image,) = {c["image"] for c in containers(*base)}
    assert {c["image"] for c in containers(*jobs, job_of_a_drive(jobs))} - {image} == {
        "docker.io/prefecthq/prefect:3.8.8-python3.11-kubernetes"
    }


def named(objects: list[dict[str, Any]], kind: str, name: str) -> dict[str, Any]:
    (found,) = (o for o in objects if (o["kind"], o["metadata"].get("name")) == (kind, name))
    return found


def test_pods_reach_what_their_settings_name() -> None:
    """Database, object storage of AWS and of MinIO as docs/operate/deploy.md names it, a Dask scheduler, Prefect."""
    rules = named(render(BASE), "NetworkPolicy", "conetl")["spec"]["egress"]
    anywhere = {port["port"] for rule in rules if "to" not in rule for port in rule["ports"]}
    text = (ROOT / "docs/operate/deploy.md").read_text(encoding="utf-8")
    minio = re.findall(r"AWS_ENDPOINT_URL=https://[\w.]+:(\d+)", text)
    dask = re.findall(r"CONETL_DASK_ADDRESS=tcp://[\w.]+:(\d+)", text)
    assert len(minio) > 0
    assert len(dask) > 0
    assert {53, 443, 5432, *map(int, (*minio, *dask))} <= anywhere
    address = named(render(BASE), "ConfigMap", "conetl")["data"]["PREFECT_API_URL"]
    (inside,) = (rule for rule in rules if "to" in rule)
    assert [f":{port['port']}/" in address for port in inside["ports"]] == [True]


def test_prefect_is_called_by_pods_of_conetl_and_by_an_ingress_controller_alone() -> None:
    objects = render(BASE)
    assert "ingress" not in named(objects, "NetworkPolicy", "conetl")["spec"], "nothing enters other pods"
    (rule,) = named(objects, "NetworkPolicy", "prefect")["spec"]["ingress"]
    own, controller = rule["from"]
    assert own == {"podSelector": {"matchLabels": {"system": "conetl"}}}
    assert set(controller) == {"namespaceSelector"}, "all pods of that namespace"
    (service,) = named(objects, "Service", "prefect")["spec"]["ports"]
    (container,) = named(objects, "Deployment", "prefect")["spec"]["template"]["spec"]["containers"]
    ports = {port["name"]: port["containerPort"] for port in container["ports"]}
    assert [port["port"] for port in rule["ports"]] == [ports[service["targetPort"]]]


def test_workers_end_after_their_runs_and_drains_evict_one_at_a_time(objects: list[dict[str, Any]]) -> None:
    for name, least_s in (("desk", 600), ("drives", 3600)):
        pod = named(objects, "Deployment", name)["spec"]["template"]["spec"]
        assert pod["terminationGracePeriodSeconds"] >= least_s
        assert pod["containers"][0]["lifecycle"]["preStop"]
    budget = named(objects, "PodDisruptionBudget", "drives")["spec"]
    assert budget["maxUnavailable"] == 1
    assert budget["selector"] == named(objects, "Deployment", "drives")["spec"]["selector"]


def test_the_hook_before_a_stop_waits_for_the_process_of_a_run() -> None:
    pod = named(render(BASE), "Deployment", "drives")["spec"]["template"]["spec"]
    *shell, script = pod["containers"][0]["lifecycle"]["preStop"]["exec"]["command"]
    run = [sys.executable, "-c", "import time; time.sleep(30)", "prefect.engine"]
    with subprocess.Popen(run) as process:
        # Of this machine's processes only that one and the hook's own, which must not take itself for a run.
        own = script.replace("/proc/[0-9]*/cmdline", f"/proc/{process.pid}/cmdline /proc/$$/cmdline")
        assert own != script
        with subprocess.Popen([*shell, own]) as hook:
            time.sleep(1.5)
            assert hook.poll() is None
            process.kill()
            process.wait()
            assert hook.wait(20) == 0


def test_workers_may_be_allowed_to_read_object_storage() -> None:
    for name in ("compose.yaml", "deploy/kubernetes/settings.yaml", "docs/operate/deploy.md"):
        text = (ROOT / name).read_text(encoding="utf-8")
        (roots, *_) = re.findall(r"/drives,s3://[\w/]+", text)
        Settings(drive_roots=roots).require_readable(as_path("s3://bucket/drives/2026-03-02"))
