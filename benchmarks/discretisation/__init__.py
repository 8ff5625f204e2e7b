"""Choices of the discretisation that no setting changes, measured in a scene.

    python -m benchmarks.discretisation STAGE --style IMAGE -o OUT [--budget SECONDS]

A page as of ``usdsmoke report``, with five sweeps: quadrature rule and step along a ray, projection
by splatting against ray marching, interpolation of the transport, order and sub-steps of the
back-trace, precision of the feature network.
"""
