"""Images in and out.

- `png`: style images, PNG files, sRGB
- `exr`: OpenEXR files
- `contact_sheet`: pictures in rows, with labels and style images
- `drawing`: smoke as pixels, for previews and contact sheets
- `preview`: draws a stage's smoke; imported by itself, as it needs OpenUSD
- `preview_request`, `preview_smoke`: what a preview shows, and of which Volumes
"""

from usdsmoke.pictures.contact_sheet import compose_sheet, sheet_files
from usdsmoke.pictures.drawing import display_picture, draw_fields, front_view, grey_picture
from usdsmoke.pictures.png import StyleImage, encode_srgb, read_style_image, write_png

__all__ = [
    "StyleImage",
    "compose_sheet",
    "display_picture",
    "draw_fields",
    "encode_srgb",
    "front_view",
    "grey_picture",
    "read_style_image",
    "sheet_files",
    "write_png",
]
