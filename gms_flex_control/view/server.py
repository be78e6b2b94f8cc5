# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The page over HTTP: who may ask, a few fixed addresses, nothing of the file system."""

import base64
import hmac
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
import ipaddress
import json
import secrets
import threading
from urllib.parse import parse_qs, urlsplit

from gms_flex_control.errors import GmsFlexError
import numpy as np

LOOPBACK = '127.0.0.1'
POLICY = ("default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; "
          "img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; "
          "frame-ancestors 'none'")
_LARGEST_BODY = 10_000  # bytes
_PATIENCE = 30.0        # for a request to come whole, or a piece to be taken [s]
_HEARTBEAT = 1.0        # at most so long without an event [s]
_TYPES = {'html': 'text/html; charset=utf-8', 'css': 'text/css; charset=utf-8',
          'js': 'text/javascript; charset=utf-8', 'svg': 'image/svg+xml',
          'json': 'application/json', 'bin': 'application/octet-stream'}
_SHARED = {'report.css': 'report.css', 'uPlot.css': 'vendor/uPlot.min.css',
           'uPlot.js': 'vendor/uPlot.iife.min.js'}


class ServerError(GmsFlexError):
    """The page cannot be served where it was asked for."""


class _BadRequest(Exception):
    """What was asked for makes no sense; the message says why."""


def refusal_of_host(host) -> str:
    """
    Return why a request to this ``Host`` is refused, '' if it is not.

    A page elsewhere can make its own name point here (DNS rebinding) and would then be of the
    same origin; a name that is not ours is therefore no way in.
    """
    try:
        name = urlsplit(f'//{host or ""}').hostname or ''
        if name == 'localhost' or ipaddress.ip_address(name).is_loopback:
            return ''
    except ValueError:
        pass
    return f'this server is not {host!r}: open the address it printed'


def refusal_of_change(headers, token) -> str:
    """Return why a request with these headers must not change anything, else ''."""
    origin, site = headers.get('Origin'), headers.get('Sec-Fetch-Site', 'same-origin')
    if origin is not None and urlsplit(origin).netloc.lower() != (
            headers.get('Host') or '').lower():
        return f'a page of {origin} may not change parameters here'
    if site not in ('same-origin', 'none'):
        return 'a page of another site may not change parameters here'
    if not hmac.compare_digest((headers.get('X-Token') or '').encode(), token.encode()):
        return 'the token of the page is missing or old: load the page again'
    return ''


def _way_out(error):
    """Return what to do when a port cannot be listened on."""
    if isinstance(error, PermissionError):
        return 'ports below 1024 are for root; name another --port, or --port 0 for a free one'
    return ('is another gms_flex view running there? Name another --port, or --port 0 for a free '
            'one')


class ViewServer(ThreadingHTTPServer):
    """
    Serve one view to this machine until it is closed; ServerError if the port is taken.

    A view has ``live`` (bool) and ``session()``; a bag ``frames(level, chunk)`` and ``plots(begin,
    end, points)``, a live one ``since(number, wait)``, ``parameters()``, ``set_parameter(name,
    value)`` and ``call(name)``. Port 0 uses a free one; the ``token`` of the page comes with every
    change.
    """

    daemon_threads = True
    block_on_close = False

    def __init__(self, view, port=0):
        self.view, self.token = view, secrets.token_urlsafe(24)
        shared = files('gms_flex_control.reports')
        self.files = {file.name: file.read_bytes()
                      for file in (files('gms_flex_control.view') / 'assets').iterdir()} | {
            name: (shared / path).read_bytes() for name, path in _SHARED.items()}
        self.stopped = threading.Event()
        try:
            super().__init__((LOOPBACK, port), _Handler)
        except OSError as error:
            raise ServerError(f'{LOOPBACK}:{port} cannot be listened on '
                              f'({(error.strerror or str(error)).lower()}); '
                              f'{_way_out(error)}') from error
        self._thread = threading.Thread(target=self.serve_forever, args=(0.1,), name='http',
                                        daemon=True)

    @property
    def url(self) -> str:
        """Return the address of the page (str)."""
        return f'http://{LOOPBACK}:{self.server_address[1]}/'

    def __enter__(self):
        """Begin to serve."""
        self._thread.start()
        return self

    def __exit__(self, *_):
        """Stop serving, and close the port."""
        self.stopped.set()
        self.shutdown()
        self.server_close()
        self._thread.join()

    def handle_error(self, request, client_address) -> None:
        """Say nothing of a browser that has gone; it does so whenever a page is closed."""


class _Handler(BaseHTTPRequestHandler):
    protocol_version = 'HTTP/1.1'
    server_version, sys_version = 'gms_flex', ''
    timeout = _PATIENCE

    def do_GET(self) -> None:
        self._answer(self._get)

    def do_HEAD(self) -> None:
        self._answer(self._get)

    def do_POST(self) -> None:
        self._answer(self._post)

    def log_message(self, *_) -> None:
        """Print nothing: the terminal belongs to whoever started the tool."""

    def _answer(self, method):
        refusal = refusal_of_host(self.headers.get('Host'))
        if refusal:
            self._refuse(HTTPStatus.FORBIDDEN, refusal)
            return
        url = urlsplit(self.path)
        try:
            method(url.path, parse_qs(url.query))
        except _BadRequest as error:
            self._refuse(HTTPStatus.BAD_REQUEST, str(error))
        except GmsFlexError as error:
            self._refuse(HTTPStatus.SERVICE_UNAVAILABLE, str(error))

    def _get(self, path, query):
        view, name = self.server.view, path.removeprefix('/assets/')
        if path == '/':
            page = self.server.files['index.html']
            self._send(page.replace(b'{token}', self.server.token.encode()), 'html')
        elif path.startswith('/assets/') and name in self.server.files:
            self._send(self.server.files[name], name.rpartition('.')[2])
        elif path == '/api/session':
            self._send_json(view.session())
        elif path == '/api/frames' and not view.live:
            self._send_table(view.frames(_whole(query, 'level'), _whole(query, 'chunk')))
        elif path == '/api/plots' and not view.live:
            self._send_table(view.plots(_number(query, 'from'), _number(query, 'to'),
                                        _whole(query, 'points')))
        elif path == '/api/live' and view.live:
            self._stream()
        elif path == '/api/parameters' and view.live:
            self._send_json(view.parameters())
        else:
            self._refuse(HTTPStatus.NOT_FOUND, f'there is nothing at {path[:200]}')

    def _post(self, path, _query):
        size = _size(self.headers.get('Content-Length'))
        body = self.rfile.read(size)
        refusal = refusal_of_change(self.headers, self.server.token)
        if refusal:
            self._refuse(HTTPStatus.FORBIDDEN, refusal)
        elif path == '/api/parameters' and self.server.view.live:
            name, value = _fields(body, 'a change', 'name', 'value')
            self._send_json(self.server.view.set_parameter(name, value))
        elif path == '/api/call' and self.server.view.live:
            name, = _fields(body, 'a request', 'name')
            self._send_json(self.server.view.call(name))
        else:
            self._refuse(HTTPStatus.NOT_FOUND, f'nothing can be set at {path[:200]}')

    def _stream(self):
        """Send what comes in as server-sent events until the page or the server goes."""
        self._begin(HTTPStatus.OK, 'text/event-stream', None)
        number = 0
        while not self.server.stopped.is_set():
            number, version, state, rows = self.server.view.since(number, _HEARTBEAT)
            event = {'version': version, **(state or {'state': ''})}
            if len(rows):
                event['rows'] = base64.b64encode(
                    np.ascontiguousarray(rows, dtype='<f8').tobytes()).decode()
            self.wfile.write(f'data: {json.dumps(event)}\n\n'.encode())
            self.wfile.flush()

    def _send_json(self, value):
        self._send(json.dumps(value, allow_nan=False).encode(), 'json')

    def _send_table(self, table):
        self._send(np.ascontiguousarray(table, dtype='<f8').tobytes(), 'bin')

    def _send(self, body, kind, status=HTTPStatus.OK):
        self._begin(status, _TYPES[kind], len(body))
        if self.command != 'HEAD':
            self.wfile.write(body)

    def _refuse(self, status, reason):
        self.close_connection = True
        self._send(json.dumps({'reason': reason}).encode(), 'json', status)

    def _begin(self, status, kind, length):
        self.send_response(status)
        for name, value in (
                ('Content-Type', kind), ('Content-Security-Policy', POLICY),
                ('X-Content-Type-Options', 'nosniff'), ('Referrer-Policy', 'no-referrer'),
                ('Cross-Origin-Resource-Policy', 'same-origin'), ('Cache-Control', 'no-store')):
            self.send_header(name, value)
        if length is None:
            self.close_connection = True
        else:
            self.send_header('Content-Length', str(length))
        if self.close_connection:
            self.send_header('Connection', 'close')
        self.end_headers()


def _number(query, name):
    """Return one finite number of a query; refuse anything else."""
    text = query.get(name, [''])[0]
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise _BadRequest(f'{name} must be a number, got {text[:80]!r}')
    return value


def _whole(query, name):
    value = _number(query, name)
    if not 0.0 <= value < 1e9:
        raise _BadRequest(f'{name} must be a whole number from 0 on, got {value:g}')
    return int(value)


def _size(text):
    if text is None or not text.isdecimal() or int(text) > _LARGEST_BODY:
        raise _BadRequest(f'a change has a length of at most {_LARGEST_BODY} bytes, '
                          f'got {(text or "none")[:40]!r}')
    return int(text)


def _fields(body, what, *names):
    """Return what the JSON of a page has by ``names``, the first a text, others also numbers."""
    try:
        given = json.loads(body)
        name, *others = (given[name] for name in names)
    except (ValueError, TypeError, KeyError, RecursionError):
        raise _BadRequest(f'{what} is JSON with {" and ".join(names)}') from None
    if not isinstance(name, str) or any(
            isinstance(one, bool) or not isinstance(one, (int, float, str)) for one in others):
        raise _BadRequest(f'{what} has a text for its name, and a number or text')
    return [name, *others]
