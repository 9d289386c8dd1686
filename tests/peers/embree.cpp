// A peer of `forelight bench rays`: traces the rays of an exported file with Embree, one by one, in robust
// mode on a high-quality tree. File and protocol are described in services/bench/src/rays/{export,peer}.rs.

#if __has_include(<embree4/rtcore.h>)
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <fstream>
#include <iostream>
#include <limits>
#include <string>
#include <vector>

#if defined(__SSE__)
#include <pmmintrin.h>
#include <xmmintrin.h>
#endif

namespace {

[[noreturn]] void fail(const std::string& reason) {
  std::cerr << "embree: " << reason << '\n';
  std::exit(1);
}

struct FileRay {
  float origin[3], t_min, direction[3], t_max;
  std::uint32_t triangle;
  float t;
};
static_assert(sizeof(FileRay) == 40);

struct Set {
  bool any;
  std::vector<FileRay> rays;
  // Embree's hits.
  std::vector<std::uint32_t> triangles;
  std::vector<float> distances;
};

struct Scene {
  std::vector<float> vertices;
  std::vector<std::uint32_t> triangles;
  std::vector<Set> sets;
};

constexpr std::uint32_t nothing = std::numeric_limits<std::uint32_t>::max();

template <class T>
void read(std::ifstream& file, T* to, std::size_t count) {
  if (!file.read(reinterpret_cast<char*>(to), static_cast<std::streamsize>(count * sizeof(T)))) fail("the file ends too early");
}

std::uint32_t word(std::ifstream& file) {
  std::uint32_t value;
  read(file, &value, 1);
  return value;
}

Scene load(const char* path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) fail(std::string("cannot read ") + path);
  char magic[8];
  read(file, magic, 8);
  if (std::memcmp(magic, "FLRAYS1\n", 8) != 0) fail("not a file of rays");
  Scene scene;
  scene.vertices.resize(std::size_t{3} * word(file));
  scene.triangles.resize(std::size_t{3} * word(file));
  scene.sets.resize(word(file));
  read(file, scene.vertices.data(), scene.vertices.size());
  read(file, scene.triangles.data(), scene.triangles.size());
  for (Set& set : scene.sets) {
    char name[16];
    read(file, name, 16);
    set.any = word(file) == 1;
    set.rays.resize(word(file));
    read(file, set.rays.data(), set.rays.size());
    set.triangles.assign(set.rays.size(), nothing);
    set.distances.assign(set.rays.size(), 0);
  }
  return scene;
}

RTCScene build(RTCDevice device, const Scene& scene) {
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
  const auto fill = [&](RTCBufferType type, RTCFormat format, const auto& from) {
    void* to = rtcSetNewGeometryBuffer(geometry, type, 0, format, 12, from.size() / 3);
    if (to == nullptr) fail("no memory for the geometry");
    std::memcpy(to, from.data(), from.size() * 4);
  };
  fill(RTC_BUFFER_TYPE_VERTEX, RTC_FORMAT_FLOAT3, scene.vertices);
  fill(RTC_BUFFER_TYPE_INDEX, RTC_FORMAT_UINT3, scene.triangles);
  rtcCommitGeometry(geometry);
  RTCScene built = rtcNewScene(device);
  rtcSetSceneFlags(built, RTC_SCENE_FLAG_ROBUST);
  rtcSetSceneBuildQuality(built, RTC_BUILD_QUALITY_HIGH);
  rtcAttachGeometry(built, geometry);
  rtcReleaseGeometry(geometry);
  rtcCommitScene(built);
  return built;
}

RTCRay prepared(const FileRay& from) {
  RTCRay ray{};
  ray.org_x = from.origin[0], ray.org_y = from.origin[1], ray.org_z = from.origin[2], ray.tnear = from.t_min;
  ray.dir_x = from.direction[0], ray.dir_y = from.direction[1], ray.dir_z = from.direction[2], ray.tfar = from.t_max;
  ray.mask = ~0u;
  return ray;
}

void trace(RTCScene scene, Set& set) {
#if RTC_VERSION_MAJOR < 4
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
#endif
  for (std::size_t i = 0; i < set.rays.size(); ++i) {
    if (set.any) {
      RTCRay ray = prepared(set.rays[i]);
#if RTC_VERSION_MAJOR < 4
      rtcOccluded1(scene, &context, &ray);
#else
      rtcOccluded1(scene, &ray);
#endif
      set.triangles[i] = ray.tfar < 0 ? 0 : nothing;
    } else {
      RTCRayHit both{};
      both.ray = prepared(set.rays[i]);
      both.hit.geomID = both.hit.primID = both.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
#if RTC_VERSION_MAJOR < 4
      rtcIntersect1(scene, &context, &both);
#else
      rtcIntersect1(scene, &both);
#endif
      set.triangles[i] = both.hit.geomID == RTC_INVALID_GEOMETRY_ID ? nothing : both.hit.primID;
      set.distances[i] = both.ray.tfar;
    }
  }
}

// Another triangle at the same distance (a shared edge, coincident surfaces) counts as equal.
bool agree(const Set& set, std::size_t i) {
  const FileRay& ray = set.rays[i];
  if (set.triangles[i] == ray.triangle) return true;
  if (set.any || set.triangles[i] == nothing || ray.triangle == nothing) return false;
  return std::abs(set.distances[i] - ray.t) <= 1e-4f * std::abs(ray.t);
}

std::int64_t cpu_nanoseconds() {
  timespec now;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return std::int64_t{1'000'000'000} * now.tv_sec + now.tv_nsec;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) fail("usage: embree FILE");
#if defined(__SSE__)
  // As Embree's manual advises.
  _MM_SET_FLUSH_ZERO_MODE(_MM_FLUSH_ZERO_ON);
  _MM_SET_DENORMALS_ZERO_MODE(_MM_DENORMALS_ZERO_ON);
#endif
  Scene scene = load(argv[1]);
  RTCDevice device = rtcNewDevice("threads=1");
  if (device == nullptr) fail("no device");
  RTCScene built = build(device, scene);
  if (rtcGetDeviceError(device) != RTC_ERROR_NONE) fail("the tree cannot be built");
  std::cout << "Embree " << RTC_VERSION_MAJOR << '.' << RTC_VERSION_MINOR << '.' << RTC_VERSION_PATCH << std::endl;
  std::string question;
  std::size_t number;
  while (std::cin >> question >> number) {
    if (number >= scene.sets.size()) fail("there is no such set");
    Set& set = scene.sets[number];
    if (question == "trace") {
      const std::int64_t start = cpu_nanoseconds();
      trace(built, set);
      std::cout << cpu_nanoseconds() - start << std::endl;
    } else if (question == "differ") {
      std::size_t differing = 0;
      for (std::size_t i = 0; i < set.rays.size(); ++i) differing += !agree(set, i);
      std::cout << differing << std::endl;
    } else {
      fail("what is " + question + "?");
    }
  }
  rtcReleaseScene(built);
  rtcReleaseDevice(device);
}
