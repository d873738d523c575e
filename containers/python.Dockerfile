# The images of our own programs: vehicle, server and evaluation, each a target. What they hold comes from build/wheelhouse
# (scripts/wheelhouse) and is installed by hash, without a network; only Debian's Python comes from outside.
ARG BASE=debian:bookworm-slim

FROM ${BASE} AS python
RUN apt-get update \
 && apt-get install -y --no-install-recommends python3 \
 && rm -rf /var/lib/apt/lists/* /var/cache/apt/* /var/log/*
# A user that owns nothing but the folders on which volumes are mounted: a new volume takes its owner from there.
RUN useradd --system --uid 10001 --user-group --no-create-home --home-dir /nonexistent --shell /usr/sbin/nologin slamcu \
 && install -d -o slamcu -g slamcu -m 0700 /data /world /keys
ENV PATH=/opt/slamcu/bin:/usr/local/bin:/usr/bin:/bin PYTHONUNBUFFERED=1 PYTHONDONTWRITEBYTECODE=1 LC_ALL=C.UTF-8
WORKDIR /

FROM python AS installer
RUN apt-get update && apt-get install -y --no-install-recommends python3-venv
COPY containers/install /usr/local/bin/install-slamcu
COPY build/wheelhouse /wheels

FROM installer AS vehicle-installed
RUN install-slamcu client

FROM python AS vehicle
COPY --from=vehicle-installed /opt/slamcu /opt/slamcu
ARG VERSION=unknown
ARG REVISION=unknown
LABEL org.opencontainers.image.title="slamcu vehicle" \
      org.opencontainers.image.description="The vehicle side of slamcu: the filter, the outbox and the uploader" \
      org.opencontainers.image.licenses="Apache-2.0" \
      org.opencontainers.image.version="${VERSION}" \
      org.opencontainers.image.revision="${REVISION}"
USER 10001:10001
ENTRYPOINT ["slamcu-vehicle"]
CMD ["--help"]

FROM installer AS server-installed
RUN install-slamcu server

FROM python AS server
COPY --from=server-installed /opt/slamcu /opt/slamcu
COPY containers/healthy /usr/local/bin/healthy
ARG VERSION=unknown
ARG REVISION=unknown
LABEL org.opencontainers.image.title="slamcu server" \
      org.opencontainers.image.description="The cloud side of slamcu: API and aggregation worker" \
      org.opencontainers.image.licenses="Apache-2.0" \
      org.opencontainers.image.version="${VERSION}" \
      org.opencontainers.image.revision="${REVISION}"
ENV SLAMCU_HOST=0.0.0.0
USER 10001:10001
ENTRYPOINT ["slamcu-server"]
CMD ["serve", "--no-worker"]

FROM installer AS evaluation-installed
RUN install-slamcu evaluation

FROM python AS evaluation
COPY --from=evaluation-installed /opt/slamcu /opt/slamcu
ARG VERSION=unknown
ARG REVISION=unknown
LABEL org.opencontainers.image.title="slamcu evaluation" \
      org.opencontainers.image.description="Simulated drives and a map provider for the demonstration of slamcu" \
      org.opencontainers.image.licenses="Apache-2.0" \
      org.opencontainers.image.version="${VERSION}" \
      org.opencontainers.image.revision="${REVISION}"
ENV MPLCONFIGDIR=/tmp
USER 10001:10001
ENTRYPOINT ["slamcu-eval"]
CMD ["--help"]
