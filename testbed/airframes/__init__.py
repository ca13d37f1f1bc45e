"""The files of an aircraft: JSBSim's elements, checks before JSBSim reads them, engines."""
