"""Images in and out.

- `png`: style images, PNG files, sRGB
- `style_size`: how large a style has to be for its marks to be as wide as voxels can hold
- `profiles`: embedded colour profiles
- `exr`, `animations`: OpenEXR files; WebP, GIF and MP4
- `exr_channels`: the channels of an OpenEXR style image, decoded in a process with limits
- `contact_sheet`: pictures in rows, with labels and style images
- `drawing`: smoke as pixels, for previews and contact sheets
- `preview`: draws a stage's smoke
- `preview_request`, `preview_volumes`: what a preview shows, and of which Volumes
- `preview_smoke`, `preview_grids`: the smoke of these Volumes
- `preview_files`: its pictures on disk

`drawing` and the modules of `preview` are imported by themselves: they need the core and OpenUSD.
Nothing needs torch but the light of a look that scatters it.
"""

from usdsmoke.pictures.animations import write_webp
from usdsmoke.pictures.contact_sheet import compose_sheet, sheet_files
from usdsmoke.pictures.png import StyleImage, encode_srgb, read_style_image, write_png
from usdsmoke.pictures.style_size import find_style_size, refine_for_less

__all__ = [
    "StyleImage",
    "compose_sheet",
    "encode_srgb",
    "find_style_size",
    "read_style_image",
    "refine_for_less",
    "sheet_files",
    "write_png",
    "write_webp",
]
