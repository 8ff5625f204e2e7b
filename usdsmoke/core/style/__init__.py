"""The style loss of a picture: networks, statistics of their features, content.

``definition``, ``layers`` and ``safetensors`` need no torch: planning reads them.

- ``definition``: the numbers that the embedded network is made of, and their hash
- ``layers``: the layers of each network, the defaults, the file of VGG-19's weights
- ``features``: feature maps of a picture; the embedded network
- ``oriented``: its fixed half, local energies of a bank of filters
- ``learned``: its other half, filters learned from the style image
- ``convolve``: convolutions with fixed filters, whose slopes are fast
- ``vgg19``: the VGG-19 network
- ``safetensors``: files of arrays, read and written
- ``style_image``: the style image at the scale of a picture, and its colour axes
- ``hues``: the hues of a style, and colours that are brought to them
- ``quantiles``: one-dimensional optimal transport between distributions of features
- ``sliced``: the same along random directions, by counting instead of sorting
- ``nearest``: the way from features to the nearest ones of the style
- ``content``: distances of a picture from its content picture
- ``losses``: the loss of a picture: Gram matrices or distributions, content, total variation
"""
