# syntax=docker/dockerfile:1
# One image for the REST service, the Ray nodes and the command line. Build: docker build -t drapemeter .
ARG PYTHON_IMAGE=python:3.11-slim-bookworm

FROM ${PYTHON_IMAGE} AS build
# The CPU build of PyTorch; give an empty value for the CUDA build that the default index holds.
ARG TORCH_INDEX=https://download.pytorch.org/whl/cpu
ENV PIP_NO_CACHE_DIR=1 PIP_DISABLE_PIP_VERSION_CHECK=1
RUN python -m venv /opt/drapemeter
WORKDIR /src
COPY requirements.txt requirements-dev.txt ./
# boto3 and what it needs: Ray's cluster launcher starts machines with it (deploy/ray-cluster.yaml)
RUN grep --extended-regexp '^(boto3|botocore|jmespath|s3transfer)==' requirements-dev.txt > launcher.txt \
    && /opt/drapemeter/bin/pip install ${TORCH_INDEX:+--extra-index-url "$TORCH_INDEX"} \
    --requirement requirements.txt --requirement launcher.txt "setuptools>=77"
COPY pyproject.toml README.md LICENSE ./
COPY simcore simcore
COPY renderer renderer
COPY capture capture
COPY metric metric
COPY trainer trainer
COPY diagnosis diagnosis
COPY services services
RUN /opt/drapemeter/bin/pip install --no-deps --no-build-isolation .

FROM ${PYTHON_IMAGE}
COPY scripts/system-packages.sh /usr/local/sbin/system-packages
# rsync: Ray's cluster launcher copies its files with it; wget: KubeRay's probes ask with it
RUN system-packages && apt-get install --yes --no-install-recommends rsync wget && rm -rf /var/lib/apt/lists/* \
    && useradd --uid 10001 --create-home --home-dir /var/lib/drapemeter drapemeter \
    && install --directory --owner drapemeter --group drapemeter /var/lib/drapemeter/cache
COPY --from=build /opt/drapemeter /opt/drapemeter
# a login shell, as Ray's cluster launcher uses, forgets PATH; of a user who is not root it has no sbin
RUN ln --symbolic /opt/drapemeter/bin/drapemeter /opt/drapemeter/bin/ray /usr/local/bin/
ENV PATH=/opt/drapemeter/bin:$PATH PYTHONUNBUFFERED=1 OMP_NUM_THREADS=1 RAY_USAGE_STATS_ENABLED=0
USER 10001
WORKDIR /var/lib/drapemeter
EXPOSE 8000
ENTRYPOINT ["drapemeter"]
CMD ["--help"]
