"""Feature networks: a picture in, named feature maps out.

``definition``, ``layers`` and ``safetensors`` need no torch: planning reads them.

- ``network``: the network that is configured; the embedded one as a whole
- ``layers``: the layers of each network, the defaults, the file of VGG-19's weights
- ``definition``: the numbers that the embedded network is made of, and their hash
- ``oriented``: its fixed half, local energies of a bank of filters
- ``learned``: its other half, filters learned from the style image
- ``whitening``: the colour axes of the style, which both halves see colours along
- ``convolve``: convolutions with fixed filters, whose slopes are fast
- ``vgg19``: the VGG-19 network
- ``safetensors``: files of arrays, read and written
"""

__all__: list[str] = []
