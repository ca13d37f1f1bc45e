"""Read all parameters of the first system, and print their number and the time as JSON.

Run in the clients' environment: read_with_mavsdk.py CONNECTION_URL
"""

import asyncio
import json
import sys
import time

from mavsdk.asyncio import Mavsdk
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.component_type import ComponentType
from mavsdk.mavsdk import Configuration


async def main(url):
    kind = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    async with Mavsdk(kind) as mavsdk:
        began = time.monotonic()
        await mavsdk.add_any_connection(url)
        systems = []
        while not systems:
            systems = [
                each for each in await mavsdk.get_systems() if await each.get_system_id() == 1
            ]
            await asyncio.sleep(0.1)
        found = await ParamAsync(systems[0]).get_all_params()
        count = len(found.float_params) + len(found.int_params)
        print(json.dumps({"count": count, "seconds": time.monotonic() - began}), flush=True)


asyncio.run(main(sys.argv[1]))
