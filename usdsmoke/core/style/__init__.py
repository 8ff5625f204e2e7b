"""The style loss of a picture: statistics of its features, content.

- ``style_image``: the style image at the scale of a picture, its tones and grey levels
- ``style_areas``: its areas with marks, which looks are painted with
- ``local_contrast``: what areas of a picture lack, in contrast or brightness, beside the style's
- ``hues``: the hues of a style, and colours that are brought to them
- ``quantiles``: one-dimensional optimal transport between distributions of features
- ``sliced``: the same along random directions, by counting instead of sorting
- ``patches``: the ways from patches to the nearest ones of the style, and back
- ``content``: distances of a picture from its content picture
- ``losses``: the loss of a picture: Gram matrices or distributions, content, total variation
"""
