"""Pictures of frames and logs, drawn with OpenCV and NumPy."""

from jaxdet.render.canvas import write_png
from jaxdet.render.frame import draw_frame
from jaxdet.render.map import draw_map

__all__ = ["draw_frame", "draw_map", "write_png"]
