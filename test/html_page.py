# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A report as a browser reads it."""

import base64
from html.parser import HTMLParser
import json

import numpy as np


class Page(HTMLParser):
    """Collect tags, handlers of events, links, words and the embedded data of a report."""

    def __init__(self, html):
        super().__init__()
        self.tags, self.handlers, self.urls, self.data = [], [], [], ''
        self.words, self._inside = [], None
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        self.tags.append(tag)
        self.handlers += [name for name in attrs if name.startswith('on')]
        self.urls += [attrs[key] for key in ('src', 'href') if key in attrs]
        self._inside = attrs.get('id') if tag == 'script' else tag

    def handle_data(self, data):
        if self._inside == 'report-data':
            self.data += data
        elif self._inside in ('h1', 'h2', 'h3', 'td', 'p'):
            self.words.append(data)

    def handle_endtag(self, tag):
        self._inside = None

    def arrays(self):
        """Return the embedded arrays."""
        return [np.frombuffer(base64.b64decode(text), dtype='<' + dtype)
                for dtype, text in json.loads(self.data)['arrays']]
