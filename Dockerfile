# The testbed of a release, for machines that have nothing but a container engine:
#   make release ARGS=--no-flight && docker build --tag formation-testbed .
#   docker run --rm --volume "$PWD:/flights" formation-testbed run simulation-3 --duration 20
# With viewer files, reports and studies: docker build --build-arg EXTRAS=-all .
FROM python:3.12-slim-bookworm

ARG EXTRAS=""

# Wheels only, with the hashes of the release's lock file; nothing is left of the build.
RUN --mount=type=bind,source=dist,target=/dist \
    cd /dist && \
    pip install --no-cache-dir --disable-pip-version-check --only-binary :all: --require-hashes \
      --requirement "$(ls formation-testbed-*[0-9]${EXTRAS}.lock)" && \
    useradd --create-home --uid 1000 pilot && \
    install --directory --owner pilot /flights

USER pilot
WORKDIR /flights
ENTRYPOINT ["formation-testbed"]
CMD ["--help"]
