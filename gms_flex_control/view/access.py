# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Who may ask the page's server for what."""

import hmac
import ipaddress
import secrets
import socket
from urllib.parse import urlsplit

LOOPBACK = '127.0.0.1'


class Access:
    """
    Rules for the requests of one server.

    Parameters
    ----------
    host : str
        Address it listens on.
    may_set : bool
        Whether requests may change parameters.

    Attributes
    ----------
    token : str
        Random; stands in the page and has to come with every change.

    """

    def __init__(self, host=LOOPBACK, may_set=True):
        self.local = is_loopback(host)
        self.may_set = may_set
        self.token = secrets.token_urlsafe(24)
        self._host = host.lower()

    def refusal_of_host(self, host):
        """
        Return why a request to this ``Host`` is refused, '' if it is not.

        A page elsewhere can make its own name point here (DNS rebinding) and would then be of
        the same origin; a name that is not ours is therefore no way in.
        """
        name = _name(f'//{host or ""}')
        if name == 'localhost' or name == self._host:
            return ''
        if is_loopback(name) or (not self.local and (
                _is_address(name) or name == socket.gethostname().lower())):
            return ''
        return f'this server is not {host!r}: open the address it printed'

    def refusal_of_change(self, headers):
        """
        Return why a request must not change anything, '' if it may.

        Parameters
        ----------
        headers : mapping of str to str
            Of the request.

        """
        origin, site = headers.get('Origin'), headers.get('Sec-Fetch-Site', 'same-origin')
        if origin is not None and urlsplit(origin).netloc.lower() != (
                headers.get('Host') or '').lower():
            return f'a page of {origin} may not change parameters here'
        if site not in ('same-origin', 'none'):
            return 'a page of another site may not change parameters here'
        if not hmac.compare_digest((headers.get('X-Token') or '').encode(),
                                   self.token.encode()):
            return 'the token of the page is missing or old: load the page again'
        if not self.may_set:
            return ('parameters can only be seen from here: start gms_flex view without --host, '
                    'or with --allow-set')
        return ''


def is_loopback(host):
    """Return whether an address or name is this machine alone."""
    if host.lower() == 'localhost':
        return True
    try:
        return ipaddress.ip_address(host.strip('[]')).is_loopback
    except ValueError:
        return False


def _is_address(name):
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def _name(url):
    try:
        return (urlsplit(url).hostname or '').lower()
    except ValueError:
        return ''
