"""Plastics and rough metals of the bundle format as a BSDF for Mitsuba 3.

Mitsuba's `roughplastic` is another model, whose coat is also rough for light that passes it. Its tables cover
single scattering only, so light that scatters more often is lost. The format's plastic has the same GGX lobe
for reflected light, and a smooth coat for light that passes, which loses nothing. At normal incidence,
`roughplastic` returns these shares of the diffuse light of the format's plastic:

| alpha | 0.05 | 0.15 | 0.2 |
| --- | --- | --- | --- |
| share | 95 % | 84 % | 78 % |

`check` compares this with Mitsuba's own values.

Mitsuba's `roughconductor` uses the Fresnel equations of an index, the format's metal Schlick's approximation.
Microfacets, Fresnel's equations and the sampling are Mitsuba's own.
"""

import math


def internal_diffuse(mitsuba, ior, steps=4096):
    """Share of diffuse light inside that a smooth coat reflects: 1 - (1 - F) / ior².

    F is the mean reflectance from outside.
    """
    reflectances = (mitsuba.fresnel(math.sqrt((i + 0.5) / steps), ior)[0] for i in range(steps))
    return 1 - (1 - sum(float(r) for r in reflectances) / steps) / ior**2


def register(mitsuba, internal):
    """Registers `format_surface` with Mitsuba, in the current variant.

    Properties: `alpha` (GGX), and either `base`, the Lambert reflectance under a coat of index `ior`, or
    `f0`, a metal's reflectance at normal incidence. `internal` holds `internal_diffuse` by index, from the
    scalar variant.
    """
    import drjit

    class FormatSurface(mitsuba.BSDF):
        def __init__(self, props):
            mitsuba.BSDF.__init__(self, props)
            self.alpha = props["alpha"]
            self.base = props.get_texture("base") if "base" in props else None
            self.f0 = None if self.base is not None else props.get_texture("f0")
            self.ior = props.get("ior", 1.5)
            flags = mitsuba.BSDFFlags
            glossy, diffuse = (lobe | flags.FrontSide for lobe in (flags.GlossyReflection, flags.DiffuseReflection))
            self.m_components = [glossy] if self.base is None else [glossy, diffuse]
            self.m_flags = glossy if self.base is None else glossy | diffuse
            if self.base is not None:
                self.series = 1 / (1 - internal[self.ior]) / self.ior**2
            # Share of samples of the glossy lobe.
            self.share = 1.0 if self.base is None else 0.5

        def facets(self):
            return mitsuba.MicrofacetDistribution(mitsuba.MicrofacetType.GGX, self.alpha, True)

        def sample(self, context, si, sample1, sample2, active=True):
            facets = self.facets()
            normal, _ = facets.sample(si.wi, sample2)
            glossy = sample1 < self.share
            drawn = mitsuba.BSDFSample3f()
            diffuse = mitsuba.warp.square_to_cosine_hemisphere(sample2)
            drawn.wo = drjit.select(glossy, mitsuba.reflect(si.wi, normal), diffuse)
            drawn.eta = 1.0
            lobes = mitsuba.BSDFFlags.GlossyReflection, mitsuba.BSDFFlags.DiffuseReflection
            drawn.sampled_type = drjit.select(glossy, *(mitsuba.UInt32(+lobe) for lobe in lobes))
            drawn.sampled_component = drjit.select(glossy, mitsuba.UInt32(0), mitsuba.UInt32(1))
            value, drawn.pdf = self.eval_pdf(context, si, drawn.wo, active)
            return drawn, drjit.select(drawn.pdf > 0, value / drawn.pdf, 0)

        def eval_pdf(self, context, si, wo, active=True):
            cos_i, cos_o = mitsuba.Frame3f.cos_theta(si.wi), mitsuba.Frame3f.cos_theta(wo)
            seen = active & (cos_i > 0) & (cos_o > 0)
            facets = self.facets()
            normal = drjit.normalize(si.wi + wo)
            cos = drjit.dot(si.wi, normal)
            if self.base is None:
                f0 = self.f0.eval(si, active)
                fresnel = f0 + (1 - f0) * (1 - cos) ** 5
            else:
                fresnel = mitsuba.Color3f(mitsuba.fresnel(cos, self.ior)[0])
            value = fresnel * (facets.eval(normal) * facets.G(si.wi, wo, normal) / (4 * cos_i))
            density = self.share * facets.pdf(si.wi, normal) / (4 * cos)
            if self.base is not None:
                passes = [1 - mitsuba.fresnel(c, self.ior)[0] for c in (cos_i, cos_o)]
                value += self.base.eval(si, active) * (passes[0] * passes[1] * self.series * cos_o / math.pi)
                density += (1 - self.share) * cos_o / math.pi
            return drjit.select(seen, value, 0), drjit.select(seen, density, 0)

        def eval(self, context, si, wo, active=True):
            return self.eval_pdf(context, si, wo, active)[0]

        def pdf(self, context, si, wo, active=True):
            return self.eval_pdf(context, si, wo, active)[1]

        def traverse(self, callback):
            pass

        def to_string(self):
            return f"FormatSurface[alpha={self.alpha}]"

    mitsuba.register_bsdf("format_surface", FormatSurface)


def check(mitsuba):
    """Compares `format_surface` with `roughplastic`. Needs the variant scalar_rgb.

    Fails unless their glossy lobes are equal, and their diffuse ones differ by the shares at the top of this
    file.
    """
    ior = 1.5
    register(mitsuba, {ior: internal_diffuse(mitsuba, ior)})
    context, si = mitsuba.BSDFContext(), mitsuba.SurfaceInteraction3f()

    def direction(cos, turn):
        sin = math.sqrt(1 - cos * cos)
        return mitsuba.Vector3f(sin * math.cos(turn), sin * math.sin(turn), cos)

    def pair(alpha, base):
        colour = {"type": "rgb", "value": [base] * 3}
        ours = {"type": "format_surface", "alpha": alpha, "ior": ior, "base": colour}
        theirs = {"type": "roughplastic", "distribution": "ggx", "alpha": alpha, "diffuse_reflectance": colour}
        # Mitsuba's default outside is air, 1.000277.
        theirs |= {"int_ior": ior, "ext_ior": 1.0, "nonlinear": False}
        return mitsuba.load_dict(ours), mitsuba.load_dict(theirs)

    def value(bsdf, wi, wo):
        si.wi = wi
        return float(bsdf.eval(context, si, wo)[0])

    up = direction(1.0, 0.0)
    for alpha, share in ((0.05, 0.952), (0.15, 0.840), (0.2, 0.781)):
        black, white = pair(alpha, 0.0), pair(alpha, 1.0)
        for cos, turn in ((1.0, 0.0), (0.9, 3.0), (0.5, 2.0), (0.2, 3.1), (0.7, 0.4)):
            for wi in (up, direction(0.6, 0.0), direction(0.2, 0.0)):
                ours, theirs = (value(bsdf, wi, direction(cos, turn)) for bsdf in black)
                if not abs(ours - theirs) <= 1e-4 * theirs + 1e-7:
                    raise SystemExit(f"glossy lobes at alpha {alpha}: {ours} and {theirs}")
        ours, theirs = (value(whole, up, up) - value(glossy, up, up) for whole, glossy in zip(white, black))
        print(f"  alpha {alpha}: {theirs / ours:.1%} of the diffuse light at normal incidence")
        if not abs(theirs / ours - share) <= 0.002:
            raise SystemExit(f"the share at alpha {alpha} was {share}")


if __name__ == "__main__":
    import mitsuba

    mitsuba.set_variant("scalar_rgb")
    check(mitsuba)
