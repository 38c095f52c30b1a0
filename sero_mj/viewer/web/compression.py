"""Compression of what the page's server sends, so that the page works over slow links."""

from __future__ import annotations

import collections
import zlib

from websockets.datastructures import Headers, MultipleValuesError
from websockets.extensions.permessage_deflate import ServerPerMessageDeflateFactory
from websockets.http11 import Request, Response

# For websockets. Higher levels take up to twice as long for 3 % less.
DEFLATE = ServerPerMessageDeflateFactory(compress_settings={"level": 1})
# Of files and models, which are compressed once, while a browser waits for its first picture:
# higher ones take more than twice as long for 4 % less.
_LEVEL = 4
_SMALLEST = 1024  # bytes
_KEPT = 32 * 2**20  # compressed bytes
_GZIP = 16 + zlib.MAX_WBITS


class CompressedResponses:
    """Compresses responses for browsers that accept it, and keeps the results.

    Files that have not changed since a browser fetched them are not sent again.
    """

    def __init__(self) -> None:
        # By checksum and length, the least recently used first.
        self._kept: collections.OrderedDict[tuple[int, int], bytes] = collections.OrderedDict()

    def compress(self, request: Request, response: Response) -> None:
        """Replaces the body of a response of status 200 by a compressed one, if that helps."""
        body, headers = response.body, response.headers
        if response.status_code != 200 or not body or len(body) < _SMALLEST:
            return
        key = zlib.crc32(body), len(body)
        if "Cache-Control" not in headers:  # the files of the page
            headers["ETag"] = tag = f'"{key[0]:08x}-{key[1]:x}"'
            headers["Cache-Control"] = "no-cache"  # kept, but asked for again
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
        if key not in self._kept:
            compressor = zlib.compressobj(_LEVEL, zlib.DEFLATED, _GZIP)
            self._kept[key] = compressor.compress(body) + compressor.flush()
            while sum(map(len, self._kept.values())) > _KEPT and len(self._kept) > 1:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return self._kept[key]


def _only(headers: Headers, name: str) -> str:
    try:
        return headers.get(name, "") or ""
    except MultipleValuesError:
        return ""
