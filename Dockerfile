# gcs-sysid without a Python of its own: docker build -t gcs-sysid .
# Live, on the host's network:   docker run --rm -it --network host gcs-sysid live udpin:0.0.0.0:14550 ...
# A log in the current folder:   docker run --rm -v "$PWD:/logs" gcs-sysid analyze flight.tlog ...
ARG PYTHON=3.12
FROM python:${PYTHON}-slim AS build
WORKDIR /source
# Dependencies first, by their hashes: they change seldom.
COPY requirements.lock ./
RUN python -m venv /opt/gcs-sysid \
    && /opt/gcs-sysid/bin/pip install --no-cache-dir --only-binary :all: --require-hashes -r requirements.lock
COPY pyproject.toml setup.py README.md LICENSE constraints.txt ./
COPY src ./src
COPY sim_bridge ./sim_bridge
RUN /opt/gcs-sysid/bin/pip install --no-cache-dir --no-deps .

FROM python:${PYTHON}-slim
COPY --from=build /opt/gcs-sysid /opt/gcs-sysid
# Recordings belong to whoever runs it: docker run --user "$(id -u):$(id -g)".
RUN useradd --create-home --uid 1000 pilot && mkdir /logs && chown pilot /logs
USER 1000:1000
WORKDIR /logs
ENV PATH=/opt/gcs-sysid/bin:$PATH \
    PYTHONUNBUFFERED=1 \
    OMP_NUM_THREADS=1
ENTRYPOINT ["gcs-sysid"]
CMD ["--help"]
