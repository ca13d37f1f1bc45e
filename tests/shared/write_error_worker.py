"""Run commands one after the other, in one process whose writes fail as each request says.

Standard input has a line of JSON for each: folder, arguments, variables of failing_writes.c. The
answers, exit code and standard error, are lines of JSON on standard output.
"""

import json
import os
import sys
import tempfile
import traceback

from commands import call

answers = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)
for line in sys.stdin:
    request = json.loads(line)
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        os.environ.update(request["variables"])
        try:
            code = call(request["arguments"], cwd=request["folder"], columns=200, out=out, err=err)
        except BaseException:
            code = traceback.format_exc()
        for name in request["variables"]:
            os.environ.pop(name)
        err.seek(0)
        print(json.dumps([code, err.read()]), file=answers, flush=True)
