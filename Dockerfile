# The image of compose.yaml: conetl from this clone, with the locked dependencies of a running system and nothing else.
FROM python:3.11-slim-bookworm AS build
WORKDIR /build
COPY . .
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheel .

FROM python:3.11-slim-bookworm
COPY requirements-runtime.txt /tmp/
RUN pip install --no-cache-dir --no-deps --require-hashes -r /tmp/requirements-runtime.txt
COPY --from=build /wheel /tmp/wheel
RUN pip install --no-cache-dir --no-deps /tmp/wheel/*.whl \
 && useradd --create-home --home-dir /var/lib/conetl --uid 10001 conetl \
 && chmod 700 /var/lib/conetl
COPY --chmod=755 scripts/with_secrets.sh /usr/local/bin/with-secrets
USER conetl
WORKDIR /var/lib/conetl
ENTRYPOINT ["with-secrets"]
CMD ["conetl", "--help"]
