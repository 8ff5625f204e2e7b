"""Images: style images, previews, contact sheets, OpenEXR."""
