"""The one exception a user's mistake becomes."""


class InputError(ValueError):
    """Says what was given, what was expected and what to do, in one sentence.

    The command line prints it without a traceback and exits with code 2; library
    users may catch it as a `ValueError`.
    """


# In the error that XLA reports where Ctrl-C reached a host function; see `hostcall`.
INTERRUPTED = "the user interrupted a host function"
