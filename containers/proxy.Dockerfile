# HAProxy from Debian with the configuration of slamcu.
ARG BASE=debian:bookworm-slim

FROM ${BASE}
RUN apt-get update \
 && apt-get install -y --no-install-recommends haproxy \
 && rm -rf /var/lib/apt/lists/* /var/cache/apt/* /var/log/*
COPY containers/haproxy.cfg containers/404.http containers/503.http /etc/haproxy/
ARG VERSION=unknown
ARG REVISION=unknown
LABEL org.opencontainers.image.title="slamcu proxy" \
      org.opencontainers.image.description="HAProxy before the API of slamcu" \
      org.opencontainers.image.licenses="Apache-2.0" \
      org.opencontainers.image.version="${VERSION}" \
      org.opencontainers.image.revision="${REVISION}"
USER haproxy
# SIGUSR1 lets answers under way finish.
STOPSIGNAL SIGUSR1
ENTRYPOINT ["haproxy", "-W", "-db", "-f", "/etc/haproxy/haproxy.cfg"]
