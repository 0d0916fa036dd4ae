// The two programs of the graphics card. They follow genesplat's own renderer: the near plane, the limit of slopes where the
// projection is linearised, the screen filters, the extent of alpha >= 1/255, the limit of 0.99.

// `row` is the width of the textures, texels.
export const vertexShader = (row) => `#version 300 es
precision highp float;
precision highp int;
uniform highp sampler2D geometry;  // of each Gaussian: position and opacity; covariance; base colour
uniform highp sampler2D harmonics;
uniform mat3 viewRotation;
uniform vec3 viewTranslation;
uniform vec3 eye;
uniform vec2 focal;                // px
uniform vec2 principal;            // px from the top left corner
uniform vec2 size;                 // of the picture, px
uniform vec2 slopeMax;
uniform float dilation;            // px²
uniform int compensation;          // 0 none, 1 as 3DGS, 2 as Mip-Splatting
uniform int terms;
uniform float near;                // world units
in vec2 corner;
in uint index;
out vec2 offset;                   // standard deviations
out vec4 colour;

const float ALPHA_MIN = 1.0 / 255.0;

vec4 texel(highp sampler2D from, int at) {
  return texelFetch(from, ivec2(at % ${row}, at / ${row}), 0);
}

vec3 harmonic(int k) {
  return (255.0 * texel(harmonics, int(index) * terms + k - 1).rgb - 128.0) / 128.0;
}

vec3 shade(vec3 base, vec3 d) {
  vec3 sum = 0.5 + 0.28209479177387814 * base;
  float x = d.x, y = d.y, z = d.z;
  if (terms >= 3) sum += 0.4886025119029199 * (-y * harmonic(1) + z * harmonic(2) - x * harmonic(3));
  float xx = x * x, yy = y * y, zz = z * z;
  if (terms >= 8) {
    sum += 1.0925484305920792 * (x * y * harmonic(4) - y * z * harmonic(5) - x * z * harmonic(7));
    sum += 0.31539156525252005 * (2.0 * zz - xx - yy) * harmonic(6) + 0.5462742152960396 * (xx - yy) * harmonic(8);
  }
  if (terms >= 15) {
    sum += -0.5900435899266435 * (y * (3.0 * xx - yy) * harmonic(9) + x * (xx - 3.0 * yy) * harmonic(15));
    sum += 2.890611442640554 * x * y * z * harmonic(10) + 1.445305721320277 * z * (xx - yy) * harmonic(14);
    sum += -0.4570457994644658 * (4.0 * zz - xx - yy) * (y * harmonic(11) + x * harmonic(13));
    sum += 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * harmonic(12);
  }
  return max(sum, 0.0);
}

// Factor on the opacity that makes up for the dilation; determinants before and after it, px⁴.
float compensate(float before, float after) {
  if (compensation == 1) return sqrt(max(2.5e-5, before / after));
  if (compensation == 2) return before <= 1e-6 ? 0.0 : sqrt(before / (after + 1e-6) + 1e-6);
  return 1.0;
}

void main() {
  gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
  int first = int(index) * 3;
  vec4 place = texel(geometry, first);
  vec3 t = viewRotation * place.xyz + viewTranslation;
  if (t.z <= near) return;

  vec4 a = texel(geometry, first + 1), b = texel(geometry, first + 2);
  mat3 covariance = mat3(a.x, a.y, a.z, a.y, a.w, b.x, a.z, b.x, b.y);
  vec2 slope = clamp(t.xy / t.z, -slopeMax, slopeMax);
  vec3 u = vec3(focal.x / t.z, 0.0, -focal.x * slope.x / t.z) * viewRotation;
  vec3 v = vec3(0.0, focal.y / t.z, -focal.y * slope.y / t.z) * viewRotation;
  vec3 alongU = covariance * u, alongV = covariance * v;
  float xx = dot(u, alongU), xy = dot(u, alongV), yy = dot(v, alongV);
  float before = max(xx * yy - xy * xy, 0.0);
  xx += dilation;
  yy += dilation;
  float alpha = place.w * compensate(before, xx * yy - xy * xy);
  if (alpha < ALPHA_MIN) return;

  // The ellipse where alpha is 1/255.
  float reach = sqrt(2.0 * log(alpha / ALPHA_MIN));
  vec2 centre = focal * t.xy / t.z + principal;
  vec2 extent = reach * sqrt(vec2(xx, yy));
  if (any(lessThan(centre + extent, vec2(0.0))) || any(greaterThan(centre - extent, size))) return;
  float middle = 0.5 * (xx + yy), apart = length(vec2(0.5 * (xx - yy), xy));
  float major = middle + apart;
  // Of the two ways to the axis, the one without cancellation.
  vec2 axis = xx >= yy ? vec2(major - yy, xy) : vec2(xy, major - xx);
  axis = apart > 1e-6 * middle ? normalize(axis) : vec2(1.0, 0.0);
  offset = reach * corner;
  vec2 scaled = offset * sqrt(vec2(major, max(middle - apart, dilation)));
  vec2 pixel = centre + scaled.x * axis + scaled.y * vec2(-axis.y, axis.x);
  gl_Position = vec4(2.0 * pixel.x / size.x - 1.0, 1.0 - 2.0 * pixel.y / size.y, 0.0, 1.0);
  uint packedBase = floatBitsToUint(b.z);
  vec3 base = (vec3(packedBase & 255u, (packedBase >> 8) & 255u, (packedBase >> 16) & 255u) / 255.0 - 0.5) / 0.15;
  colour = vec4(shade(base, normalize(place.xyz - eye)), alpha);
}`;

export const FRAGMENT_SHADER = `#version 300 es
precision highp float;
in vec2 offset;
in vec4 colour;
out vec4 blended;
void main() {
  float alpha = min(0.99, colour.a * exp(-0.5 * dot(offset, offset)));
  if (alpha < 1.0 / 255.0) discard;
  blended = vec4(alpha * colour.rgb, alpha);
}`;
