"""The sweep's manifests: fields that KubeRay knows, and as many workers as the largest cluster has cores."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import yaml

DEPLOY = Path(__file__).parents[2] / "deploy"

# Names of the fields of ray.io/v1 as KubeRay 1.4 declares them (apis/ray/v1/rayjob_types.go and raycluster_types.go).
JOB = {
    "activeDeadlineSeconds", "backoffLimit", "rayClusterSpec", "submitterPodTemplate", "metadata", "clusterSelector",
    "submitterConfig", "managedBy", "deletionStrategy", "entrypoint", "runtimeEnvYAML", "jobId", "submissionMode",
    "entrypointResources", "entrypointNumCpus", "entrypointNumGpus", "ttlSecondsAfterFinished",
    "shutdownAfterJobFinishes", "suspend",
}  # fmt: skip
CLUSTER = {
    "headGroupSpec", "workerGroupSpecs", "rayVersion", "enableInTreeAutoscaling", "autoscalerOptions",
    "headServiceAnnotations", "suspend",
}  # fmt: skip
HEAD = {"serviceType", "headService", "enableIngress", "rayStartParams", "template"}
WORKERS = {
    "groupName", "replicas", "minReplicas", "maxReplicas", "numOfHosts", "rayStartParams", "template", "scaleStrategy",
}  # fmt: skip


def workers_of(command: str) -> int:
    """Value of ``--workers`` in a command line."""
    words = shlex.split(command)
    return int(words[words.index("--workers") + 1])


def test_the_rayjob_has_fields_that_kuberay_knows() -> None:
    job = yaml.safe_load((DEPLOY / "kuberay-rayjob.yaml").read_text(encoding="utf-8"))
    assert (job["apiVersion"], job["kind"]) == ("ray.io/v1", "RayJob")
    spec: dict[str, Any] = job["spec"]
    cluster = spec["rayClusterSpec"]
    assert set(spec) <= JOB and set(cluster) <= CLUSTER
    groups = [(cluster["headGroupSpec"], HEAD), *((group, WORKERS) for group in cluster["workerGroupSpecs"])]
    for group, known in groups:
        assert {"rayStartParams", "template"} <= set(group) <= known
        assert all(isinstance(value, str) for value in group["rayStartParams"].values()), "parameters are strings"
        assert set(group["template"]) <= {"metadata", "spec"}
    names = {"groupName", "minReplicas", "maxReplicas"}
    assert all(names <= set(group) for group in cluster["workerGroupSpecs"])
    cores = sum(
        int(group["maxReplicas"]) * int(group["template"]["spec"]["containers"][0]["resources"]["requests"]["cpu"])
        for group in cluster["workerGroupSpecs"]
    )
    assert cluster["enableInTreeAutoscaling"] is True and workers_of(spec["entrypoint"]) == cores


def test_the_cluster_launcher_asks_for_as_many_workers_as_it_may_start_cores() -> None:
    text = (DEPLOY / "ray-cluster.yaml").read_text(encoding="utf-8")
    cluster = yaml.safe_load(text)
    worker = cluster["available_node_types"]["worker"]
    command = re.search(r"'(drapemeter dataset [^']*)'", text)
    assert command is not None
    assert workers_of(command.group(1)) == worker["max_workers"] * worker["resources"]["CPU"]
