// A robot's program in C++ that takes observations whether or not a daemon can be reached.
//
//   queue_example HOST:PORT FOLDER COUNT [PATIENCE_SECS]
//
// It takes observations of a door, one for each hour, up to number COUNT, from the one behind the last that the queue
// took. With a patience it waits until the daemon has all of them; else the next run sends the rest.

#include <cstdint>
#include <iostream>
#include <string>

#include "tidemap/queue.hpp"

namespace {

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kMonday = 1'767'571'200 * kSecond;  // 2026-01-05T00:00:00Z

int run(const std::string& server, const std::string& folder, std::uint64_t count, double patience_secs) {
  tidemap::QueueOptions options;
  options.server = server;
  options.map = "office";
  options.producer = "cpp-robot";
  options.folder = folder;
  options.bytes_max = 64 << 20;
  tidemap::QueuedProducer producer(options);
  for (auto number = producer.state().last + 1; number <= count; ++number) {
    const auto time_nanos = kMonday + static_cast<std::int64_t>(number) * 3600 * kSecond;
    try {
      producer.send("door", time_nanos, number % 24 >= 8 && number % 24 < 18 ? 1 : 0);
    } catch (const tidemap::QueueFull& full) {
      std::cerr << full.what() << "\n";
      return 1;
    }
  }
  if (patience_secs > 0) {
    producer.flush(patience_secs);
  }
  const auto state = producer.state();
  std::cout << "taken " << state.last << ", waiting " << state.waiting << ", refused " << state.refused << std::endl;
  producer.close();
  return 0;
}

}  // namespace

int main(int count, char** words) {
  if (count < 4 || count > 5) {
    std::cerr << "use: queue_example HOST:PORT FOLDER COUNT [PATIENCE_SECS]\n";
    return 2;
  }
  try {
    return run(words[1], words[2], std::stoull(words[3]), count == 5 ? std::stod(words[4]) : 0);
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
  }
}
