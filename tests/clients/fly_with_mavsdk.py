"""Command the leader of a run with MAVSDK, and print results as one JSON object per line.

Run in the clients' environment: fly_with_mavsdk.py CONNECTION_URL
"""

import asyncio
import json
import math
import sys

from mavsdk.asyncio import Mavsdk
from mavsdk.asyncio.plugins.action import ActionAsync
from mavsdk.asyncio.plugins.info import InfoAsync
from mavsdk.asyncio.plugins.manual_control import ManualControlAsync
from mavsdk.asyncio.plugins.mission_raw import MissionRawAsync
from mavsdk.asyncio.plugins.offboard import OffboardAsync
from mavsdk.asyncio.plugins.param import ParamAsync
from mavsdk.asyncio.plugins.telemetry import TelemetryAsync
from mavsdk.component_type import ComponentType
from mavsdk.mavsdk import Configuration
from mavsdk.plugins.mission_raw import MissionItem
from mavsdk.plugins.offboard import Attitude

LATITUDE_DEG, LONGITUDE_DEG, ELEVATION_M = 38.0, 0.0, 300.0  # of the scenario's origin
NORTH_DEG = 1.0 / 110_996.0  # per metre, at this latitude
EAST_DEG = 1.0 / 87_832.0
RELATIVE, WAYPOINT, UNLIMITED = 6, 16, 17


def report(step, **values):
    print(json.dumps({"step": step, **values}), flush=True)


def position(north, east):
    return LATITUDE_DEG + north * NORTH_DEG, LONGITUDE_DEG + east * EAST_DEG


def item(number, command, north, east, altitude):
    latitude, longitude = position(north, east)
    return MissionItem(
        number,
        RELATIVE,
        command,
        int(number == 0),
        1,
        x=round(latitude * 1e7),
        y=round(longitude * 1e7),
        z=altitude,
    )


async def until(stream, holds):
    """Return the first value of a stream for which the condition holds; without a timeout."""
    async for value in stream:
        if holds(value):
            return value
    raise EOFError("the stream has ended")


async def systems(mavsdk, count):
    while len(await mavsdk.get_systems()) < count:
        await asyncio.sleep(0.1)
    return {await each.get_system_id(): each for each in await mavsdk.get_systems()}


def fields(thing):
    return {
        name: int(value) if isinstance(value, int) else value for name, value in vars(thing).items()
    }


async def keep_texts(telemetry, texts):
    async for text in telemetry.subscribe_status_text():
        texts.append(text.text)


async def hold_left(manual):
    while True:
        await manual.set_manual_control_input(0.0, -0.5, 0.5, 0.0)
        await asyncio.sleep(0.05)


async def main(url):
    async with Mavsdk(
        Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    ) as mavsdk:
        await mavsdk.add_any_connection(url)
        found = await systems(mavsdk, 4)
        report("systems", ids=sorted(found))
        leader = found[1]
        telemetry, action = TelemetryAsync(leader), ActionAsync(leader)
        texts = []
        listening = asyncio.create_task(keep_texts(telemetry, texts))

        await until(telemetry.subscribe_health_all_ok(), bool)
        report(
            "health", **fields(await until(telemetry.subscribe_health(), lambda h: h.is_armable))
        )
        report("in air", value=await until(telemetry.subscribe_in_air(), bool))
        charged = TelemetryAsync(found[2]).subscribe_battery()
        report("battery", **fields(await until(charged, lambda b: b.voltage_v > 0.0)))
        report("armed", value=await until(telemetry.subscribe_armed(), bool))
        home = await until(telemetry.subscribe_home(), lambda h: True)
        report("home", altitude_m=home.absolute_altitude_m)
        info = InfoAsync(leader)
        version, identity = await info.get_version(), await info.get_identification()
        report(
            "version",
            numbers=[
                version.flight_sw_major,
                version.flight_sw_minor,
                version.flight_sw_patch,
            ],
            uid=identity.hardware_uid,
        )

        param = ParamAsync(leader)
        before = await param.get_param_float("RLL_RATE_P")
        await param.set_param_float("RLL_RATE_P", 0.11)
        report(
            "parameter",
            before=before,
            after=await param.get_param_float("RLL_RATE_P"),
            count=len((await param.get_all_params()).float_params),
        )

        mission = MissionRawAsync(leader)
        here = await until(telemetry.subscribe_position(), lambda p: True)
        north = (here.latitude_deg - LATITUDE_DEG) / NORTH_DEG
        east = (here.longitude_deg - LONGITUDE_DEG) / EAST_DEG
        items = [
            item(0, WAYPOINT, 0.0, 0.0, 0.0),
            item(1, WAYPOINT, north, east + 200.0, 100.0),
            item(2, WAYPOINT, north + 300.0, east + 200.0, 120.0),
            item(3, UNLIMITED, north + 600.0, east, 110.0),
        ]
        await mission.upload_mission(items)
        back = await mission.download_mission()
        report(
            "mission",
            same=[
                all(
                    getattr(one, name) == getattr(other, name)
                    for name in ("seq", "command", "x", "y", "z")
                )
                for one, other in zip(items[1:], back[1:], strict=True)
            ],
            begun_at_m=[north, east],
        )

        await action.hold()
        mode = await until(telemetry.subscribe_flight_mode(), lambda m: m.name == "HOLD")
        report("mode", name=mode.name)
        await mission.start_mission()
        mode = await until(telemetry.subscribe_flight_mode(), lambda m: m.name == "MISSION")
        report("mode", name=mode.name)
        target = position(north, east + 200.0)
        progress = await until(mission.subscribe_mission_progress(), lambda p: p.current >= 2)
        at = await until(telemetry.subscribe_position(), lambda p: True)
        report(
            "progress",
            current=progress.current,
            total=progress.total,
            off_m=math.hypot(
                (at.latitude_deg - target[0]) / NORTH_DEG, (at.longitude_deg - target[1]) / EAST_DEG
            ),
        )

        there = position(north + 200.0, east - 200.0)
        await action.goto_location(*there, ELEVATION_M + 130.0, 0.0)
        mode = await until(
            telemetry.subscribe_flight_mode(), lambda m: m.name not in ("MISSION", "HOLD")
        )
        report("goto", mode=mode.name)

        offboard = OffboardAsync(leader)
        await offboard.set_attitude(Attitude(25.0, 2.0, 0.0, 0.5))
        await offboard.start()
        banked = await until(telemetry.subscribe_attitude_euler(), lambda a: a.roll_deg > 20.0)
        report("offboard", roll_deg=banked.roll_deg)

        await action.hold()
        await until(telemetry.subscribe_flight_mode(), lambda m: m.name == "HOLD")

        manual, last = ManualControlAsync(found[4]), TelemetryAsync(found[4])
        sticks = asyncio.create_task(hold_left(manual))
        banked = await until(last.subscribe_attitude_euler(), lambda a: a.roll_deg < -18.0)
        report("manual", roll_deg=banked.roll_deg)
        sticks.cancel()

        listening.cancel()
        report("texts", texts=texts)


asyncio.run(main(sys.argv[1]))
