"""Fast starts of programs: `Forked` forks a server process that has imported all modules.

A normal start needs a second of processor time for imports; a fork needs a fiftieth of that. A
forked program has its own arguments, environment, folder and streams, and the signal handlers of a
new interpreter.
"""

import atexit
import ctypes
import gc
import inspect
import json
import os
import runpy
import signal
import socket
import subprocess
import sys
import threading
import warnings
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

PROGRAM = Path(sys.executable).with_name("smarttouch")
EMULATOR = [sys.executable, "-m", "smarttouch.emulator"]
_SUBREAPER = 36
"""PR_SET_CHILD_SUBREAPER of Linux: orphaned descendants become children of this process."""
_LONGEST = 1 << 20
_MOST_FILES = 1 << 10
_IMPORTED = (
    "smarttouch.boards.kits.etactilekit", "smarttouch.boards.kits.kajimoto61",
    "smarttouch.boards.link.link_driver", "smarttouch.emulator.__main__",
    "smarttouch.emulator.etactilekit_firmware", "smarttouch.emulator.kajimoto61_firmware",
    "smarttouch.emulator.link_board", "smarttouch.experiments.contact_and_force_calibration",
    "smarttouch.reading.braille_lines", "smarttouch.reading.letter_shapes",
    "smarttouch.running.replay_check",
    "smarttouch.running.recorder", "smarttouch.sources.virtual_finger",
    "smarttouch.views.terminal_session", "smarttouch.views.window",
)  # fmt: skip


class _Server:
    """Process that forks a copy of itself for each program."""

    def __init__(self):
        self._lock = threading.Lock()
        self._channel, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with its:
            # -P: import the installed packages, not files beside this script.
            command = [sys.executable, "-P", __file__, str(its.fileno())]
            self._process = subprocess.Popen(command, pass_fds=[its.fileno()])

    def fork(self, request, streams):
        """Fork a program as a child of this process; return its process ID."""
        with self._lock:
            _adopt(True)
            try:
                socket.send_fds(self._channel, [json.dumps(request).encode()], streams)
                # Receive 0 when the program has its parent, and the program's ID, in either order.
                return max(int(self._channel.recv(20)) for _ in range(2))
            finally:
                _adopt(False)

    def close(self):
        self._channel.close()
        self._process.wait()


class _SelfServer:
    """Variant of `_Server` in a forked program. The program forks itself to emulate a board."""

    def fork(self, request, streams):
        # Text that is still buffered would be written by parent and child.
        for each in (sys.stdout, sys.stderr):
            each.flush()
        with warnings.catch_warnings():
            # Ignore that this process has threads: the child does not use these threads.
            warnings.simplefilter("ignore", DeprecationWarning)
            if number := os.fork():
                return number
        # Drop what the child inherits: exit handlers, signal handlers and, below, open files.
        atexit._clear()
        signal.set_wakeup_fd(-1)
        for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            handler = signal.default_int_handler if each == signal.SIGINT else signal.SIG_DFL
            if signal.getsignal(each) != signal.SIG_IGN:
                signal.signal(each, handler)
        _become(request, [os.dup(each) for each in streams])
        os.closerange(3, _MOST_FILES)
        return _run_and_end(import_module(request["module"]).main)


def emulator(device, *options):
    """Return the command that emulates a device; ``options`` are those of its URL."""
    return [*EMULATOR, f"{device}?{'&'.join(options)}"]


def forked_boards():
    """Return a replacement for module subprocess that lets a driver fork its emulated board."""
    return SimpleNamespace(**vars(subprocess) | {"Popen": Forked})


def share_priority(pid):
    """Give a process the real-time priority of this thread, if the thread has it.

    In tests in real time, a busy computer then delays neither the host nor the emulated board.
    """
    policy = os.sched_getscheduler(0)
    if policy & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO:
        os.sched_setscheduler(pid, policy, os.sched_getparam(0))


def _adopt(wanted):
    ctypes.CDLL(None).prctl(_SUBREAPER, int(wanted), 0, 0, 0)


class Forked(subprocess.Popen):
    """Variant of `subprocess.Popen` that forks the program, the emulator and Python scripts.

    All other commands start as new processes, as in `subprocess.Popen`.
    """

    _server = None

    def _execute_child(self, *given):
        asked = inspect.signature(super()._execute_child).bind(*given).arguments
        command = [os.fspath(each) for each in asked["args"]]
        if command[0] == str(PROGRAM):
            module, arguments = "smarttouch.cli", command
        elif command[:3] == EMULATOR:
            module, arguments = "smarttouch.emulator.__main__", command[2:]
        elif command[0] == sys.executable and command[1].endswith(".py"):
            module, arguments = None, command[1:]
        else:
            super()._execute_child(*given)
            return
        request = {
            "module": module,
            "arguments": arguments,
            "environment": dict(os.environ if asked["env"] is None else asked["env"]),
            "folder": os.fspath(asked["cwd"] or Path.cwd()),
            "session": asked["start_new_session"],
        }
        ends = (asked["p2cread"], asked["c2pwrite"], asked["errwrite"])
        streams = [own if end == -1 else end for own, end in enumerate(ends)]
        Forked._server = Forked._server or _Server()
        self.pid = Forked._server.fork(request, streams)
        self._child_created = True
        if command[:3] == EMULATOR:
            share_priority(self.pid)
        names = ("p2cread", "p2cwrite", "c2pread", "c2pwrite", "errread", "errwrite")
        self._close_pipe_fds(*(asked[name] for name in names))

    @classmethod
    def end(cls):
        """End the server process, if it was started."""
        if cls._server is not None:
            cls._server.close()
            cls._server = None


def _serve(channel):
    """Fork at each request. The fork returns the program's main function; the server, None."""
    for module in _IMPORTED:
        import_module(module)
    import_module("smarttouch.cli")._built()
    driver = import_module("smarttouch.emulator.drivers")
    driver.subprocess, Forked._server = forked_boards(), _SelfServer()
    # Write the delivery log more often, because many tests wait for it.
    import_module("smarttouch.emulator.devices")._WRITE_EVERY_NS = 10_000_000
    gc.collect()
    # Otherwise the garbage collector of each fork would modify, and so copy, all objects.
    gc.freeze()
    while True:
        message, streams, _, _ = socket.recv_fds(channel, _LONGEST, 3)
        if not message:
            return None
        # Fork twice. The process in between ends, so the requesting process becomes the parent.
        between = os.fork()
        if not between:
            if os.fork():
                os._exit(0)
            request = json.loads(message)
            _become(request, streams)
            channel.send(b"%d" % os.getpid())
            channel.close()
            return _main_of(request)
        os.waitpid(between, 0)
        channel.send(b"0")
        for each in streams:
            os.close(each)


def _main_of(request):
    """Return the main function of a requested module, or a function that runs a script."""
    if request["module"] is not None:
        return import_module(request["module"]).main
    path = Path(request["arguments"][0]).resolve()
    sys.path.insert(0, str(path.parent))
    return lambda: runpy.run_path(str(path), run_name="__main__")


def _become(request, streams):
    """Set up a forked process as a new one: session, folder, environment, arguments, streams."""
    registry = import_module("smarttouch.boards.run_registry")
    registry._begun_ns = registry._start_ns(os.getpid())
    if request["session"]:
        os.setsid()
    os.chdir(request["folder"])
    os.environ.clear()
    os.environ.update(request["environment"])
    sys.argv = request["arguments"]
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    at_once = bool(os.environ.get("PYTHONUNBUFFERED"))
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        old = getattr(sys, name)
        encoding = os.environ.get("PYTHONIOENCODING", old.encoding)
        new = os.fdopen(old.fileno(), mode, encoding=encoding, errors=old.errors, closefd=False)
        if mode == "w":
            new.reconfigure(line_buffering=new.isatty() or name == "stderr", write_through=at_once)
        setattr(sys, name, new)
        setattr(sys, f"__{name}__", new)


def _run_and_end(main):
    """Run a program and its exit handlers, then exit at once, without freeing Python's objects."""
    code = 0
    try:
        main()
    except SystemExit as ended:
        code = ended.code or 0
    except BaseException:
        sys.excepthook(*sys.exc_info())
        code = 1
    threading._shutdown()
    atexit._run_exitfuncs()
    sys.stdout.flush()
    os._exit(code)


if __name__ == "__main__":
    program = _serve(socket.socket(fileno=int(sys.argv[1])))
    if program is not None:
        _run_and_end(program)
