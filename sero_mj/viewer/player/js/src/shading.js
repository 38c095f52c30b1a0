/** Shades surfaces in the light of the surroundings, with linear colors as in Filament. */

/**
 * Uniforms with the light of the sky, as computed by `SkyLight` in Python.
 * @typedef {{fill: {value: import("three").Vector3}, reflections: {value: import("three").Texture}}} SkyUniforms
 */

// Sources: Filament's documentation, 4.4 (Lambert's diffuse lobe) and 5.3.4 (levels of reflections
// by roughness); Karis, Optimizing PBR for Mobile, 2014 (highlights of lamps), and Physically Based
// Shading on Mobile, 2014 (how much of the sky is reflected); sRGB and its inverse, to 0.003:
// Chilliant, sRGB Approximations for HLSL, 2012.
const LIGHT = `
  uniform vec3 fill; uniform sampler2D reflections;
  struct Surface { vec3 albedo; vec3 specular; float roughness; };
  vec3 toLight(vec3 shown) { return shown * (shown * (shown * .305306 + .682171) + .012523); }
  vec3 toShown(vec3 light) {
    light = min(min(light, .83 + .6 * (light - .83)), 1.); // Filament's tone mapping near white
    vec3 a = sqrt(max(light, 0.)), b = sqrt(a), c = sqrt(b);
    return max(.662002687 * a + .684122060 * b - .323583601 * c - .0225411470 * light, 0.);
  }
  Surface surfaceOf(vec3 shown, float specular, float roughness, float metallic) {
    vec3 albedo = toLight(shown);
    return Surface(albedo * (1. - metallic), mix(vec3(.08 * specular), albedo, metallic), roughness);
  }
  void fromLamp(const in IncidentLight lamp, const in vec3 place, const in vec3 normal, const in vec3 eye,
      const in vec3 coat, const in Surface surface, inout ReflectedLight reflected) {
    vec3 lit = saturate(dot(normal, lamp.direction)) * lamp.color * RECIPROCAL_PI;
    reflected.directDiffuse += lit * surface.albedo;
    #ifndef MATTE
    vec3 middle = normalize(lamp.direction + eye);
    float alpha = max(surface.roughness * surface.roughness, .01), square = alpha * alpha;
    float across = saturate(dot(normal, middle)), along = saturate(dot(lamp.direction, middle));
    float d = across * across * (square - 1.) + 1.;
    reflected.directSpecular += lit * surface.specular
      * (square / (d * d * max(along * along, .1) * (alpha + .5) * 4.));
    #endif
  }
  void fromSky(const in vec3 normal, const in vec3 eye, const in Surface surface, inout ReflectedLight reflected) {
    vec3 up = viewMatrix[2].xyz;
    float y = dot(normal, up);
    reflected.indirectDiffuse += surface.albedo * (fill.x + fill.y * y + fill.z * (3. * y * y - 1.));
    #ifndef MATTE
    float facing = saturate(dot(normal, eye));
    vec2 count = vec2(textureSize(reflections, 0));
    vec2 where = vec2(.5 - .5 * dot(reflect(eye, normal), up), surface.roughness * (2. - surface.roughness));
    float seen = texture2D(reflections, (.5 + where * (count - 1.)) / count).r;
    vec4 r = surface.roughness * vec4(-1., -.0275, -.572, .022) + vec4(1., .0425, 1.04, -.04);
    float bent = min(r.x * r.x, exp2(-9.28 * facing)) * r.x + r.y;
    vec2 share = vec2(-1.04, 1.04) * bent + r.zw;
    reflected.indirectSpecular += seen * (surface.specular * share.x
      + share.y * saturate(dot(surface.specular, vec3(16.5))));
    #endif
  }
  #define RE_Direct fromLamp
`;

/**
 * Makes a Phong shader compute with linear colors.
 * @param {import("three").WebGLProgramParametersWithUniforms} shader @param {SkyUniforms} uniforms
 * @param {string} surface GLSL, a `Surface`
 */
export function shade(shader, { fill, reflections }, surface) {
  Object.assign(shader.uniforms, { fill, reflections });
  shader.fragmentShader = shader.fragmentShader
    .replace("#include <lights_phong_pars_fragment>", `varying vec3 vViewPosition;${LIGHT}`)
    .replace("#include <lights_phong_fragment>", `Surface material = ${surface};`)
    .replace("#include <lights_fragment_end>",
      "fromSky(normal, geometryViewDir, material, reflectedLight);")
    .replace("#include <opaque_fragment>",
      "outgoingLight = toShown(outgoingLight);\n#include <opaque_fragment>");
}
