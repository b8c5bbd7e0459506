# The image of compose.yaml: conetl from this clone, with the locked dependencies.
FROM python:3.11-slim-bookworm
WORKDIR /opt/conetl
COPY requirements.txt pyproject.toml README.md LICENSE prefect.yaml ./
RUN pip install --no-cache-dir --no-deps --require-hashes -r requirements.txt
COPY src src
COPY flows flows
COPY sql sql
COPY data/models data/models
RUN pip install --no-cache-dir --no-deps --no-build-isolation . \
 && useradd --create-home --home-dir /var/lib/conetl conetl
USER conetl
WORKDIR /var/lib/conetl
