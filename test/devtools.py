# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""A headless Chromium driven by its own DevTools protocol over two pipes, nothing else needed."""

import base64
from contextlib import suppress
import json
import os
from pathlib import Path
import select
import shutil
import subprocess
import sys
import time

PATIENCE = 60.0  # for anything that has to come [s]
_FLAGS = ('--headless', '--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run',
          '--disable-background-networking', '--disable-component-update', '--disable-sync',
          '--disable-dev-shm-usage', '--hide-scrollbars', '--remote-debugging-pipe')
# Chromium wants its pipes as descriptors 3 and 4
_LAUNCH = ('import fcntl, os, sys; '
           'ends = [fcntl.fcntl(int(end), fcntl.F_DUPFD, 10) for end in sys.argv[1:3]]; '
           '[os.dup2(end, place) for end, place in zip(ends, (3, 4))]; '
           'os.execv(sys.argv[3], sys.argv[3:])')
KEYS = {' ': 'Space', 'ArrowLeft': 'ArrowLeft', 'ArrowRight': 'ArrowRight', 'Home': 'Home',
        'End': 'End', 'Tab': 'Tab', 'Enter': 'Enter'}
_CODES = {' ': 32, 'ArrowLeft': 37, 'ArrowRight': 39, 'Home': 36, 'End': 35, 'Tab': 9,
          'Enter': 13}


class BrowserError(AssertionError):
    """The browser did not do what had to come."""


def chromium():
    """Return the path of an installed Chromium, or of Google's, None if there is none."""
    names = ('chromium', 'chromium-browser', 'google-chrome', 'google-chrome-stable')
    return next(filter(None, map(shutil.which, names)), None)


class Browser:
    """One headless Chromium with one page; its profile goes to an empty ``folder``."""

    def __init__(self, folder):
        self._folder = Path(folder)
        self._number, self._unread, self._session = 0, b'', None
        self.errors = []  # exceptions and console errors of the page

    def __enter__(self):
        their_input, self._output = os.pipe()
        self._input, their_output = os.pipe()
        command = [sys.executable, '-c', _LAUNCH, str(their_input), str(their_output),
                   chromium(), *_FLAGS, f'--user-data-dir={self._folder}', 'about:blank']
        self._log = (self._folder.parent / f'{self._folder.name}.log').open('wb')
        self._process = subprocess.Popen(command, pass_fds=(their_input, their_output),
                                         stdin=subprocess.DEVNULL, stdout=self._log,
                                         stderr=self._log)
        os.close(their_input)
        os.close(their_output)
        target = next(one for one in self.call('Target.getTargets')['targetInfos']
                      if one['type'] == 'page')
        self._session = self.call('Target.attachToTarget', targetId=target['targetId'],
                                  flatten=True)['sessionId']
        for domain in ('Page', 'Runtime', 'Log', 'Network'):
            self.call(f'{domain}.enable')
        return self

    def __exit__(self, *_):
        with suppress(BrowserError, OSError):
            self._session = None
            self.call('Browser.close')
        try:
            self._process.wait(timeout=10.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        for descriptor in (self._input, self._output):
            os.close(descriptor)
        self._log.close()

    def call(self, method, **parameters):
        """Return the result of one command of the protocol."""
        self._number += 1
        message = {'id': self._number, 'method': method, 'params': parameters}
        if self._session is not None:
            message['sessionId'] = self._session
        os.write(self._output, json.dumps(message).encode() + b'\0')
        while True:
            answer = self._message()
            if answer.get('id') == self._number:
                if 'error' in answer:
                    raise BrowserError(f'{method}: {answer["error"]}')
                return answer['result']
            self._note(answer)

    def _message(self):
        end = time.monotonic() + PATIENCE
        while b'\0' not in self._unread:
            if not select.select([self._input], [], [], max(end - time.monotonic(), 0.0))[0]:
                raise BrowserError('chromium says nothing')
            piece = os.read(self._input, 1 << 16)
            if not piece:
                raise BrowserError('chromium has ended')
            self._unread += piece
        text, _, self._unread = self._unread.partition(b'\0')
        return json.loads(text)

    def _note(self, event):
        parameters = event.get('params', {})
        if event.get('method') == 'Runtime.exceptionThrown':
            details = parameters['exceptionDetails']
            self.errors.append(details.get('exception', {}).get('description', details['text']))
        elif event.get('method') == 'Log.entryAdded' and parameters['entry']['level'] == 'error':
            self.errors.append(parameters['entry']['text'])

    def screen(self, width, height, *, dark=False, calm=False, scale=1):
        """Set the size of the page [px] and what its user prefers."""
        self.call('Emulation.setDeviceMetricsOverride', width=width, height=height,
                  deviceScaleFactor=scale, mobile=False)
        self.call('Emulation.setEmulatedMedia', features=[
            {'name': 'prefers-color-scheme', 'value': 'dark' if dark else 'light'},
            {'name': 'prefers-reduced-motion', 'value': 'reduce' if calm else 'no-preference'}])

    def visit(self, url):
        """Load a page."""
        self.call('Page.navigate', url='about:blank')
        self.call('Page.navigate', url=url)

    def ask(self, expression):
        """Return the value of a JavaScript expression in the page; of a promise what it gives."""
        answer = self.call('Runtime.evaluate', expression=expression, returnByValue=True,
                           awaitPromise=True)
        if 'exceptionDetails' in answer:
            raise BrowserError(f'{expression}: {answer["exceptionDetails"]}')
        return answer['result'].get('value')

    def until(self, expression, bound=PATIENCE):
        """Wait until a JavaScript expression is true; return its value."""
        end, value = time.monotonic() + bound, None
        while not value:
            with suppress(BrowserError):  # while the page goes over to another
                value = self.ask(expression)
            if not value and time.monotonic() > end:
                raise BrowserError(f'waited in vain for {expression}; page errors: '
                                   f'{self.errors}; {self.ask("document.body.innerText")[:2000]}')
            time.sleep(0.0 if value else 0.02)
        return value

    def press(self, key, *, shift=False):
        """Press a key, as the keyboard does."""
        common = {'key': key, 'code': KEYS.get(key, key), 'modifiers': 8 if shift else 0,
                  'windowsVirtualKeyCode': _CODES.get(key, ord(key.upper()[0]))}
        text = {'text': {'Enter': '\r'}.get(key, key)} if len(key) == 1 or key == 'Enter' else {}
        self.call('Input.dispatchKeyEvent', type='keyDown', **common, **text)
        self.call('Input.dispatchKeyEvent', type='keyUp', **common)

    def type_text(self, text):
        """Type into what has the focus."""
        self.call('Input.insertText', text=text)

    def click(self, selector):
        """Click the middle of an element with the mouse."""
        x, y = self.ask(f"""(() => {{ const found = document.querySelector({selector!r});
            found.scrollIntoView({{block: 'center'}});
            const box = found.getBoundingClientRect();
            return [box.x + box.width / 2, box.y + box.height / 2]; }})()""")
        for kind in ('mousePressed', 'mouseReleased'):
            self.call('Input.dispatchMouseEvent', type=kind, x=x, y=y, button='left', clickCount=1)

    def drag(self, selector, right, down):
        """Drag from the middle of an element by so many pixels."""
        x, y = self.ask(f"""(() => {{ const box = document.querySelector({selector!r})
            .getBoundingClientRect(); return [box.x + box.width / 2, box.y + box.height / 2];
            }})()""")
        for kind, share in (('mousePressed', 0), ('mouseMoved', 0.5), ('mouseMoved', 1),
                            ('mouseReleased', 1)):
            self.call('Input.dispatchMouseEvent', type=kind, x=x + share * right,
                      y=y + share * down, button='left', buttons=1, clickCount=1)

    def picture(self, *, whole=False):
        """Return what is to be seen as a PNG (bytes); ``whole`` takes the page to its end."""
        return base64.b64decode(self.call('Page.captureScreenshot', format='png',
                                          captureBeyondViewport=whole)['data'])
