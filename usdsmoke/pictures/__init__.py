"""Images in and out.

- `preview`: draws a stage's smoke; `preview_request`, `preview_smoke`: what and where
- `drawing`: smoke as pixels, for previews and contact sheets
- `contact_sheet`: pictures in rows, with labels and style images
- `png`: style images, PNG files, sRGB
- `exr`: OpenEXR files

Each file is imported by itself: planning reads style images without loading the rest.
"""
