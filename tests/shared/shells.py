"""Shells whose `testbed` commands run in the test process, which has imported everything."""

import json
import socket
import stat
import subprocess
import sys
import tempfile

from commands import call
from waiting import TIMEOUT_S

CLIENT = f"""#!{sys.executable} -IS
import json, os, socket, sys
line = socket.socket(fileno=int(os.environ["TESTBED_SOCKET"]))
socket.send_fds(line, [json.dumps([os.getcwd(), sys.argv[1:]]).encode()], [1, 2])
sys.exit(int(line.recv(16)))
"""


def write_program(path, text=CLIENT):
    """Write a program; by default one that passes its command to `run_shell`."""
    path.write_text(text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)


def run_shell(command, *, cwd, env, columns=80):
    """Run a command with a shell, and what its clients pass on; return exit code and output."""
    server, client = socket.socketpair()
    with server, tempfile.TemporaryFile("w+") as output:
        server.settimeout(TIMEOUT_S)
        shell = subprocess.Popen(
            command,
            cwd=cwd,
            env=env | {"TESTBED_SOCKET": str(client.fileno())},
            stdout=output,
            stderr=output,
            pass_fds=[client.fileno()],
        )
        try:
            client.close()
            while True:  # until the shell and its children have closed the socket
                request, files, *_ = socket.recv_fds(server, 65536, 2)
                if not request:
                    break
                folder, arguments = json.loads(request)
                with open(files[0], "w") as out, open(files[1], "w") as err:
                    code = call(arguments, cwd=folder, columns=columns, out=out, err=err)
                server.sendall(str(code).encode())
            shell.wait(timeout=TIMEOUT_S)
        finally:
            shell.kill()
            shell.wait()
        output.seek(0)
        return shell.returncode, output.read()
