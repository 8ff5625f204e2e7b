"""What of a stage a reference to its root prims leaves behind, and what can be put in its place.

A reference brings one root prim and what is below it. Targets and connections that lead out of it
are dropped, as are parts of path expressions; these can be said again by the layer that makes the
reference. Opinions of a class that a prim inherits from come along by themselves. Referencing the
class as well would raise them above what the inheriting prim says.
"""

from dataclasses import dataclass, field

from pxr import Sdf, Usd

from usdsmoke.base.errors import LayerError

__all__ = ["Reach", "find_reach", "leads_out", "root_of"]

_EXPRESSION = Sdf.ValueTypeNames.PathExpression
_ADVICE = "set layer.mode to sublayer (--mode sublayer), or"


@dataclass(frozen=True)
class Reach:
    """What referencing root prims one by one takes."""

    roots: list[Usd.Prim] = field(default_factory=list)  # to be referenced, in the stage's order
    relationships: dict[Sdf.Path, list[Sdf.Path]] = field(default_factory=dict)  # leading out
    connections: dict[Sdf.Path, list[Sdf.Path]] = field(default_factory=dict)  # likewise
    expressions: dict[Sdf.Path, Sdf.PathExpression] = field(default_factory=dict)  # all


def find_reach(stage: Usd.Stage) -> Reach:
    """The root prims of a stage, and what about them has to be said again.

    Args:
        stage: composed; only read.

    Raises:
        LayerError: something cannot be carried: a target that leads out of an instance and its root
            prim, or a root prim that is itself shown and that another one inherits from.
    """
    reach = Reach()
    bases: dict[Sdf.Path, Sdf.Path] = {}  # root prims: who inherits from them
    predicate = Usd.TraverseInstanceProxies(Usd.PrimAllPrimsPredicate)
    for prim in Usd.PrimRange.Stage(stage, predicate):
        if prim.HasAuthoredInherits():
            for path in prim.GetInherits().GetAllDirectInherits():
                if root_of(path) != root_of(prim.GetPath()):
                    bases.setdefault(root_of(path), prim.GetPath())
        for item in prim.GetAuthoredProperties():
            _look_at(item, reach)
    for prim in stage.GetPseudoRoot().GetAllChildren():
        if prim.GetPath() not in bases:
            reach.roots.append(prim)
        elif prim.IsDefined() and not prim.IsAbstract():
            raise LayerError(
                f"an asset cannot hold <{prim.GetPath()}>, which is no class and which "
                f"<{bases[prim.GetPath()]}> inherits from: referenced, it would be stronger than "
                f"that prim; {_ADVICE} make it a class"
            )
    return reach


def root_of(path: Sdf.Path) -> Sdf.Path:
    """The root prim that a path lies in.

    >>> root_of(Sdf.Path("/World/smoke.field:density"))
    Sdf.Path('/World')
    """
    return path.GetPrefixes()[0]


def leads_out(prim_path: Sdf.Path, targets: list[Sdf.Path]) -> bool:
    """Whether a target lies in another root prim than ``prim_path``."""
    return any(root_of(target) != root_of(prim_path) for target in targets)


def _look_at(item: Usd.Property, reach: Reach) -> None:
    if isinstance(item, Usd.Relationship):
        targets, noted = item.GetTargets(), reach.relationships
    else:
        targets = item.GetConnections() if item.HasAuthoredConnections() else []
        noted = reach.connections
        is_expression = item.GetTypeName() == _EXPRESSION
        if is_expression and not item.GetPrim().IsInstanceProxy():
            reach.expressions[item.GetPath()] = item.Get() or Sdf.PathExpression()
    if not targets or not leads_out(item.GetPath(), targets):
        return
    if item.GetPrim().IsInstanceProxy():
        raise LayerError(
            f"an asset cannot hold <{item.GetPath()}>, which leads from inside an instance to "
            f"{', '.join(f'<{path}>' for path in targets)} in another root prim; {_ADVICE} bring "
            "both below one root prim"
        )
    noted[item.GetPath()] = list(targets)
