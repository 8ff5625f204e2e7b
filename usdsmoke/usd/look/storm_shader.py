"""The volume shader of a look for Hydra Storm, as the text of a glslfx file.

Storm marches through world space, and asks the shader for extinction and emission per world unit.
What is stored is per unit of the stage that the look was made for. The shader therefore goes by the
Volume's own space: ``stageUnitsPerUnit`` is how many of those stage units one unit of that space
was, and the Volume's transform says how many world units it is now. A look referenced under another
scale keeps its picture. A scale that differs along the axes counts with its geometric mean.

Storm adds emission for a whole step and then dims it, so that thick steps come out too bright by
tau / (1 - exp(-tau)), where tau is the step's optical depth. The shader takes that factor off where
Storm tells how long a step is (OpenUSD 25.08 does).
"""

EXTINCTION = "extinctionPerDensity"
ALBEDO = "albedo"
STAGE_UNITS = "stageUnitsPerUnit"
PER_DENSITY = "emissionIsPerDensity"
DENSITY, EMISSION, SCATTER = "density", "emission", "scatter"

_PARAMETERS = {
    EMISSION: '"emission": { "type": "vec3", "default": [0.0, 0.0, 0.0] },\n        ',
    SCATTER: '"scatter": { "type": "vec3", "default": [0.0, 0.0, 0.0] },\n        ',
}
_EMITTED = {True: "vec3(HdGet_emission(p).xyz)", False: "vec3(0.0)"}
_SCATTERED = {True: "dot(vec3(HdGet_scatter(p).xyz), vec3(0.2126, 0.7152, 0.0722))", False: "1.0"}


def storm_shader(emits: bool, scatters_colour: bool) -> str:
    """The file's text.

    Args:
        emits: whether the look has an emission.
        scatters_colour: whether a field holds its scattering colour, of which Storm draws the
            luminance.
    """
    wanted = {EMISSION: emits, SCATTER: scatters_colour}
    parameters = "".join(text for name, text in _PARAMETERS.items() if wanted[name])
    return (
        _SHADER.replace("PARAMETERS", parameters)
        .replace("EMITTED", _EMITTED[emits])
        .replace("SCATTERED", _SCATTERED[scatters_colour])
    )


_SHADER = """\
-- glslfx version 0.1

// The volume shader of a look by usdsmoke, for Hydra Storm.

-- configuration
{
    "techniques": {
        "default": {
            "volumeShader": { "source": [ "Usdsmoke.Volume" ] }
        }
    },
    "parameters": {
        "density": { "type": "float", "default": 0.0 },
        PARAMETERS"extinctionPerDensity": { "type": "float", "default": 1.0 },
        "albedo": { "type": "float", "default": 0.0 },
        "stageUnitsPerUnit": { "type": "float", "default": 1.0 },
        "emissionIsPerDensity": { "type": "float", "default": 0.0 }
    }
}

-- glsl Usdsmoke.Volume

FORWARD_DECL(MAT4 ApplyInstanceTransformInverse(MAT4 m));

// Stage units of the time the look was made, for one world unit of now.
float
usdsmokeStageUnits()
{
    const MAT4 worldToLocal = ApplyInstanceTransformInverse(HdGet_transformInverse());
    const mat3 m = mat3(vec3(worldToLocal[0].xyz), vec3(worldToLocal[1].xyz),
                        vec3(worldToLocal[2].xyz));
    return HdGet_stageUnitsPerUnit() * pow(abs(determinant(m)), 1.0 / 3.0);
}

float
usdsmokeDensity(vec3 p)
{
    return max(float(HdGet_density(p)), 0.0);
}

float
extinctionFunction(vec3 p)
{
    return HdGet_extinctionPerDensity() * usdsmokeStageUnits() * usdsmokeDensity(p);
}

float
scatteringFunction(vec3 p)
{
    return HdGet_albedo() * SCATTERED * extinctionFunction(p);
}

// What is left of a step's emission on its way through the step.
float
usdsmokeAttenuation(float density)
{
#ifdef HD_HAS_sampleDistance
    const float stepSize = 0.5 * HdGet_stepSize() * float(HdGet_sampleDistance());
    const float tau =
        HdGet_extinctionPerDensity() * HdGet_stageUnitsPerUnit() * stepSize * density;
    return tau > 1e-3 ? (1.0 - exp(-tau)) / tau : 1.0 - 0.5 * tau;
#else
    return 1.0;
#endif
}

vec3
emissionFunction(vec3 p)
{
    const float density = usdsmokeDensity(p);
    const float scale = HdGet_emissionIsPerDensity() > 0.5 ? density : 1.0;
    return usdsmokeStageUnits() * scale * usdsmokeAttenuation(density)
        * EMITTED;
}

float
phaseFunction(vec3 direction1, vec3 direction2)
{
    return 0.25 / 3.14159265358979;
}
"""
