"""Compresses the responses of a page's server for slow network connections."""

from __future__ import annotations

import collections
import zlib

from websockets.datastructures import Headers, MultipleValuesError
from websockets.extensions.permessage_deflate import ServerPerMessageDeflateFactory
from websockets.http11 import Request, Response

# Higher levels for websockets take up to twice as long and save 3 %.
DEFLATE = ServerPerMessageDeflateFactory(compress_settings={"level": 1})
# Files and models are compressed once, while a browser waits. Higher levels take more than twice
# as long and save 4 %.
_LEVEL = 4
_MIN_SIZE = 1024  # bytes
_CACHE = 32 * 2**20  # maximum size of all cached results, bytes
_GZIP = 16 + zlib.MAX_WBITS


class CompressedResponses:
    """Compresses responses for browsers that accept gzip, and caches the results.

    If a browser already has the current version of a file, the file is not sent again.
    """

    def __init__(self) -> None:
        # The keys are checksum and length. The first entry is the least recently used one.
        self._cached: collections.OrderedDict[tuple[int, int], bytes] = collections.OrderedDict()

    def compress(self, request: Request, response: Response) -> None:
        """Compresses the body of a response with status 200, unless the body is short."""
        body, headers = response.body, response.headers
        if response.status_code != 200 or not body or len(body) < _MIN_SIZE:
            return
        key = zlib.crc32(body), len(body)
        if "Cache-Control" not in headers:  # This is a file of the page.
            headers["ETag"] = tag = f'"{key[0]:08x}-{key[1]:x}"'
            headers["Cache-Control"] = "no-cache"  # Browsers cache the file and check its ETag.
            if _only(request.headers, "If-None-Match") == tag:
                response.status_code, response.reason_phrase = 304, "Not Modified"
                body = b""
        if body and "gzip" in _only(request.headers, "Accept-Encoding"):
            body = self._compressed(key, bytes(body))
            headers["Content-Encoding"] = "gzip"
        headers["Vary"] = "Accept-Encoding"
        response.body = body
        del headers["Content-Length"]
        headers["Content-Length"] = str(len(body))

    def _compressed(self, key: tuple[int, int], body: bytes) -> bytes:
        if key not in self._cached:
            compressor = zlib.compressobj(_LEVEL, zlib.DEFLATED, _GZIP)
            self._cached[key] = compressor.compress(body) + compressor.flush()
            while sum(map(len, self._cached.values())) > _CACHE and len(self._cached) > 1:
                self._cached.popitem(last=False)
        self._cached.move_to_end(key)
        return self._cached[key]


def _only(headers: Headers, name: str) -> str:
    try:
        return headers.get(name, "") or ""
    except MultipleValuesError:
        return ""
