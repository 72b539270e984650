"""A little S3: buckets of objects over HTTP, as much of the protocol as Arrow's client speaks."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit
from xml.sax.saxutils import escape

XML = "<?xml version='1.0' encoding='UTF-8'?>"


class Objects:
    """What is in the buckets, and what was asked for.

    Attributes:
        held: Contents by ``/bucket/key``.
        puts: Keys in the order in which they became visible.
        refused: A status that every request is answered with; 0: none.
        url: Of a bucket, for Arrow.
    """

    def __init__(self) -> None:
        self.held: dict[str, bytes] = {}
        self.puts: list[str] = []
        self.uploads: dict[str, dict[int, bytes]] = {}
        self.refused = 0
        self.url = ""

    def put(self, key: str, content: bytes) -> None:
        self.held[key] = content
        self.puts.append(key)


@contextmanager
def s3_server() -> Iterator[Objects]:
    """Serves one until the end of the block."""
    objects = Objects()
    server = ThreadingHTTPServer(
        ("127.0.0.1", 0), type("Handler", (_Handler,), {"objects": objects})
    )
    options = f"endpoint_override=127.0.0.1:{server.server_port}&scheme=http&region=us-east-1"
    objects.url = f"s3://name:secret@bucket/some/place?{options}"
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        yield objects
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


class _Handler(BaseHTTPRequestHandler):
    objects: Objects
    protocol_version = "HTTP/1.1"

    def log_message(self, format: str, *args: Any) -> None:
        pass

    def _answer(self, status: int, content: bytes = b"", **headers: Any) -> None:
        self.send_response(status)
        length = headers.pop("length", len(content))
        for name, value in {"ETag": '"1"', **headers}.items():
            self.send_header(name.replace("_", "-"), str(value))
        self.send_header("Content-Length", str(length))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(content)

    def _body(self) -> bytes:
        if "chunked" not in self.headers.get("Transfer-Encoding", ""):
            data = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        else:
            data = b""
            while size := int(self.rfile.readline().split(b";")[0], 16):
                data += self.rfile.read(size)
                self.rfile.readline()
            self.rfile.readline()
        if "aws-chunked" not in self.headers.get("Content-Encoding", ""):
            return data
        found, rest = b"", data
        while rest:
            head, _, rest = rest.partition(b"\r\n")
            size = int(head.split(b";")[0], 16)
            if not size:
                break
            found, rest = found + rest[:size], rest[size + 2 :]
        return found

    def _request(self) -> tuple[str, dict[str, str], bytes]:
        parts = urlsplit(self.path)
        query = {key: value[0] for key, value in parse_qs(parts.query, True).items()}
        return unquote(parts.path), query, self._body()

    def _handle(self) -> None:
        key, query, body = self._request()
        if self.objects.refused:
            text = f"{XML}<Error><Code>AccessDenied</Code><Message>Access Denied</Message></Error>"
            self._answer(self.objects.refused, text.encode())
        else:
            getattr(self, f"_{self.command.lower()}")(key, query, body)

    do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = _handle  # noqa: N815

    def _get(self, key: str, query: dict[str, str], _: bytes) -> None:
        if "list-type" in query:
            self._list(key, query)
        elif (content := self.objects.held.get(key)) is None:
            self._answer(404, f"{XML}<Error><Code>NoSuchKey</Code></Error>".encode())
        elif asked := self.headers.get("Range"):
            first, last = asked.removeprefix("bytes=").split("-")
            stop = min(int(last) + 1 if last else len(content), len(content))
            span = f"bytes {first}-{stop - 1}/{len(content)}"
            self._answer(206, content[int(first) : stop], Content_Range=span)
        else:
            self._answer(200, content)

    def _head(self, key: str, query: dict[str, str], _: bytes) -> None:
        content = self.objects.held.get(key)
        whole = content is not None or key.count("/") == 1
        self._answer(200 if whole else 404, length=len(content or b""))

    def _put(self, key: str, query: dict[str, str], body: bytes) -> None:
        if "partNumber" in query:
            self.objects.uploads[query["uploadId"]][int(query["partNumber"])] = body
        else:
            self.objects.put(key, body)
        self._answer(200)

    def _post(self, key: str, query: dict[str, str], _: bytes) -> None:
        if "uploads" in query:
            number = str(len(self.objects.uploads) + 1)
            self.objects.uploads[number] = {}
            text = f"<UploadId>{number}</UploadId>"
            kind = "InitiateMultipartUploadResult"
        else:
            parts = self.objects.uploads.pop(query["uploadId"])
            self.objects.put(key, b"".join(parts[number] for number in sorted(parts)))
            text, kind = f"<Key>{escape(key)}</Key>", "CompleteMultipartUploadResult"
        self._answer(200, f"{XML}<{kind}>{text}</{kind}>".encode())

    def _delete(self, key: str, query: dict[str, str], _: bytes) -> None:
        self.objects.uploads.pop(query.get("uploadId", ""), None)
        self.objects.held.pop(key, None)
        self._answer(204)

    def _list(self, bucket: str, query: dict[str, str]) -> None:
        prefix, bucket = query.get("prefix", ""), bucket.rstrip("/")
        files, folders = [], set()
        for key, content in sorted(self.objects.held.items()):
            name = key.removeprefix(f"{bucket}/")
            if not name.startswith(prefix):
                continue
            below, slash, _ = name[len(prefix) :].partition("/")
            if slash and query.get("delimiter"):
                folders.add(f"{prefix}{below}/")
            else:
                size = f"<Size>{len(content)}</Size>"
                files.append(f"<Contents><Key>{escape(name)}</Key>{size}</Contents>")
        common = [
            f"<CommonPrefixes><Prefix>{escape(one)}</Prefix></CommonPrefixes>" for one in folders
        ]
        count = f"<KeyCount>{len(files) + len(common)}</KeyCount><IsTruncated>false</IsTruncated>"
        kind = "ListBucketResult"
        self._answer(200, f"{XML}<{kind}>{count}{''.join([*files, *common])}</{kind}>".encode())
