"""The application: routers, problem documents, limits, and what lives as long as it does."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack, asynccontextmanager
from importlib.metadata import version

from fastapi import FastAPI
from fastapi_offline import FastAPIOffline
from sqlalchemy.ext.asyncio import AsyncEngine
from starlette.middleware.gzip import GZipMiddleware

from slamcu_server import problems
from slamcu_server.accounts.service import Authenticator
from slamcu_server.aggregation.policy import load_policy
from slamcu_server.aggregation.worker import run_worker
from slamcu_server.database.engine import create_engine
from slamcu_server.health.endpoints import router as health
from slamcu_server.ingest.quota import Quota
from slamcu_server.metrics.endpoints import router as metrics
from slamcu_server.metrics.instruments import Instruments
from slamcu_server.middleware import LimitBody, Observe
from slamcu_server.routes import ROUTERS
from slamcu_server.runtime import WorkerSupervisor, open_database
from slamcu_server.settings import Settings

_WORKER_GRACE_S = 2.0
_WORKER_CONNECTIONS = 2  # to listen, and to work

_DESCRIPTION = """\
Vehicles report what they saw of the HD map; the service fuses the reports and publishes the changes that it believes.

Every request carries an API key (`Authorization: Bearer slamcu_…`). A *vehicle* key reports and fetches maps; a
*provider* key reads maps, features and changes, and reviews changes. Errors are RFC 9457 problem documents.
"""


def create_app(settings: Settings, *, engine: AsyncEngine | None = None) -> FastAPI:
    """Make the application.

    Parameters
    ----------
    settings : its settings.
    engine : an open database of the right schema; without it the application opens that of the settings at its
        start and closes it at its end.

    Raises FormatError if the aggregation policy of the settings cannot be used.
    """
    load_policy(settings.policy_file)  # reviews and a worker would only learn when they need it, again and again

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        async with AsyncExitStack() as stack:
            used = engine
            if used is None:
                used = await stack.enter_async_context(open_database(settings, application_name="slamcu-server"))
            app.state.engine = used
            # Connections of their own: readiness and the worker must not wait for those that requests keep busy.
            app.state.readiness = create_engine(used.url, application_name="slamcu-ready", pool_size=1)
            stack.push_async_callback(app.state.readiness.dispose)
            app.state.authenticator = Authenticator(used)
            app.state.worker = None
            if settings.embedded_worker:
                instruments: Instruments = app.state.instruments
                mine = create_engine(used.url, application_name="slamcu-worker", pool_size=_WORKER_CONNECTIONS)
                stack.push_async_callback(mine.dispose)
                app.state.worker = WorkerSupervisor(
                    lambda stop: run_worker(mine, settings, stop, instruments=instruments)
                )
                app.state.worker.start()
                stack.push_async_callback(app.state.worker.stop, _WORKER_GRACE_S)
            yield

    app = FastAPIOffline(  # /docs asks for an API key: no script of anybody else's runs beside it
        static_url="/docs/static",
        title="slamcu",
        version=version("slamcu-server"),
        description=_DESCRIPTION,
        lifespan=lifespan,
        redirect_slashes=False,  # an unknown route is a 404, not a detour
        responses=problems.responses(422, 500, 503),
    )
    app.state.settings = settings
    app.state.instruments = Instruments()
    app.state.quota = Quota(settings.passes_per_s, settings.passes_burst)
    for router in ROUTERS:
        app.include_router(router)
    problems.install(app)
    app.add_middleware(LimitBody, limit=settings.max_body_bytes)
    app.add_middleware(GZipMiddleware, minimum_size=1024, compresslevel=5)
    app.add_middleware(Observe, instruments=app.state.instruments)
    return app


def create_worker_app(engine: AsyncEngine, worker: WorkerSupervisor, instruments: Instruments) -> FastAPI:
    """Make the application by which a worker process tells how it is: /livez, /readyz and /metrics."""
    app = FastAPI(title="slamcu worker", docs_url=None, redoc_url=None, openapi_url=None, redirect_slashes=False)
    app.state.engine, app.state.worker, app.state.instruments = engine, worker, instruments
    app.state.readiness = engine  # nothing but the worker and /metrics uses it
    for router in (health, metrics):
        app.include_router(router)
    problems.install(app)
    app.add_middleware(Observe, instruments=instruments)
    return app
