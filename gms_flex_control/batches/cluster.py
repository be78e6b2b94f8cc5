# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Items on an existing Dask cluster (optional extra ``dask``)."""

from concurrent.futures import CancelledError
import pickle

from gms_flex_control.batches.journal import fingerprint
from gms_flex_control.errors import BatchError, LostItemError

_PATIENCE = '10s'  # for the scheduler to answer
MISSING = ("--scheduler needs Dask: pip install '.[dask]' in the clone, or leave it out for "
           'processes of this machine')


def call_packed(item, function):
    """Return what ``function`` returns for a pickled item."""
    return function(pickle.loads(item))


class Cluster:
    """
    An Executor over the workers of a Dask scheduler; see executor.Executor.

    Parameters
    ----------
    address : str
        Of the scheduler.

    Raises
    ------
    BatchError
        If Dask is not installed, the scheduler does not answer, has no workers, or one of them
        runs another version of this package.

    """

    def __init__(self, address):
        try:
            from distributed import Client
        except ImportError as error:
            raise BatchError(MISSING) from error
        self._address = address
        try:
            self._client = Client(address, timeout=_PATIENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            raise BatchError(f'--scheduler {address}: does not answer ({error}); start it with '
                             'dask scheduler, or leave the option out') from error
        try:
            self._require_workers()
        except BaseException:
            self._client.close()
            raise

    def __enter__(self):
        """Return the executor itself."""
        return self

    def __exit__(self, *_):
        """Leave the cluster; what it was still doing for this run is given up."""
        self._client.close()

    def _require_workers(self):
        try:
            found = self._client.run(fingerprint)
        except ModuleNotFoundError as error:
            raise BatchError(f'--scheduler {self._address}: its workers lack {error.name}; '
                             'install this package where they run') from error
        if not found:
            raise BatchError(f'--scheduler {self._address}: has no workers; start some with '
                             f'dask worker {self._address}')
        own = fingerprint()
        for worker, sources in found.items():
            if sources != own:
                raise BatchError(f'--scheduler {self._address}: worker {worker} runs other '
                                 'sources of this package; install the same version there and '
                                 'start it anew')

    def finished(self, function, items):
        """Yield index and result of each item; the scheduler repeats what a dead worker had."""
        from distributed import as_completed, KilledWorker

        # every item is a task of its own, even where another run asked for an equal one; packed,
        # because Dask looks through tuples and lists for tasks, at many times the cost
        futures = self._client.map(call_packed, [pickle.dumps(item) for item in items],
                                   function=function, pure=False)
        places = {future.key: index for index, future in enumerate(futures)}
        try:
            for future in as_completed(futures, loop=self._client.loop):
                if future.cancelled():
                    raise CancelledError
                killed = isinstance(future.exception(), KilledWorker)
                yield places[future.key], self._lost if killed else future.result
        except (CancelledError, OSError) as error:
            raise BatchError(f'--scheduler {self._address}: the connection was lost; what is '
                             'finished is kept, start again to go on') from error

    def _lost(self):
        raise LostItemError(f'--scheduler {self._address}: one item killed every worker that took '
                            'it; is there enough memory?')
