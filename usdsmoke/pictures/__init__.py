"""Images in and out.

- `png`: style images, PNG files, sRGB
- `exr`, `webp`: OpenEXR files, animations
- `exr_channels`: the channels of an OpenEXR style image, decoded in a process with limits
- `contact_sheet`: pictures in rows, with labels and style images
- `drawing`: smoke as pixels, for previews and contact sheets
- `preview`: draws a stage's smoke
- `preview_request`, `preview_smoke`, `preview_grids`: what a preview shows, and of which Volumes
- `preview_files`: its pictures on disk

`drawing` and `preview` are imported by themselves: they need torch and OpenUSD.
"""

from usdsmoke.pictures.contact_sheet import compose_sheet, sheet_files
from usdsmoke.pictures.png import StyleImage, encode_srgb, read_style_image, write_png
from usdsmoke.pictures.webp import write_webp

__all__ = [
    "StyleImage",
    "compose_sheet",
    "encode_srgb",
    "read_style_image",
    "sheet_files",
    "write_png",
    "write_webp",
]
