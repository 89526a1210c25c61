"""Logs behind a URL: what they are, and a copy of them on this machine.

`identify` asks the store for name, ETag and size; `fetched` lends a copy from the cache.
"""

from imucal.remote.addresses import RemoteLog, is_url
from imucal.remote.copies import LocalCopy, fetched, forget
from imucal.remote.stores import expand, identify, logs_at

__all__ = ["LocalCopy", "RemoteLog", "expand", "fetched", "forget", "identify", "is_url", "logs_at"]
