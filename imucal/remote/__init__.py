"""Logs behind a URL: what they are, and a copy of them on this machine.

`identify` asks the store for name, ETag and size; `fetched` lends a copy from the cache.
"""

from imucal.remote.addresses import is_url
from imucal.remote.copies import LocalCopy, fetched
from imucal.remote.listing import expand, identify, logs_at
from imucal.remote.log_cache import forget
from imucal.remote.remote_log import RemoteLog

__all__ = ["LocalCopy", "RemoteLog", "expand", "fetched", "forget", "identify", "is_url", "logs_at"]
