# PostgreSQL 15 with PostGIS 3, from Debian.
ARG BASE=debian:bookworm-slim

FROM ${BASE}
# The settings first: Debian's packages would make and start a cluster of their own. Compilation at run time is off
# (postgresql.conf), and its compiler would be a quarter of the image.
RUN mkdir -p /etc/postgresql-common && echo 'create_main_cluster = false' > /etc/postgresql-common/createcluster.conf \
 && apt-get update \
 && apt-get install -y --no-install-recommends postgresql-15 postgresql-15-postgis-3 postgresql-15-postgis-3-scripts \
 && rm -rf /var/lib/apt/lists/* /var/cache/apt/* /var/log/* /usr/share/i18n \
 && rm -rf /usr/lib/postgresql/15/lib/bitcode /usr/lib/postgresql/15/lib/llvmjit* \
           /usr/lib/*/libLLVM-* /usr/lib/*/libz3.so* /usr/lib/llvm-*
# A tmpfs takes the mode of what it covers.
RUN install -d -o postgres -g postgres -m 0700 /var/lib/slamcu-database && install -d -m 1777 /run/slamcu-database
COPY containers/database-entrypoint /usr/local/bin/database-entrypoint
COPY containers/postgresql.conf /etc/slamcu/postgresql.conf
ARG VERSION=unknown
ARG REVISION=unknown
LABEL org.opencontainers.image.title="slamcu database" \
      org.opencontainers.image.description="PostgreSQL 15 with PostGIS 3 and the database of slamcu" \
      org.opencontainers.image.licenses="Apache-2.0" \
      org.opencontainers.image.version="${VERSION}" \
      org.opencontainers.image.revision="${REVISION}"
ENV PATH=/usr/lib/postgresql/15/bin:/usr/local/bin:/usr/bin:/bin PGDATA=/var/lib/slamcu-database/data \
    PGHOST=/run/slamcu-database LC_ALL=C.UTF-8
USER postgres
VOLUME /var/lib/slamcu-database
# SIGINT is PostgreSQL's fast shutdown: it ends sessions and writes a checkpoint.
STOPSIGNAL SIGINT
ENTRYPOINT ["database-entrypoint"]
