"""What must hold: expressions, specifications and plant files as data, their readers and their JSON Schema.

``reader`` is the front door of this room (`read_specification`, `read_plant`); ``specification`` holds the data
classes that everything else codes against. Nothing here knows torch, ONNX or any other room.
"""
