"use strict";
document.documentElement.classList.add("js");
document.querySelectorAll(".slider").forEach(function (pair) {
  var input = pair.parentElement.querySelector("input[type=range]");
  function show() {
    pair.style.setProperty("--cut", input.value + "%");
    input.setAttribute("aria-valuetext", input.value + "%");
  }
  input.addEventListener("input", show);
  show();
});
document.querySelectorAll("table.sortable").forEach(function (table) {
  var body = table.tBodies[0];
  table.querySelectorAll("thead th").forEach(function (head, column) {
    var button = document.createElement("button");
    button.type = "button";
    button.textContent = head.textContent;
    head.textContent = "";
    head.appendChild(button);
    button.addEventListener("click", function () {
      var up = head.getAttribute("aria-sort") !== "ascending";
      table.querySelectorAll("th").forEach(function (other) { other.removeAttribute("aria-sort"); });
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      function key(row) {
        var cell = row.cells[column], text = cell.dataset.value || cell.textContent;
        return cell.classList.contains("text") ? text : Number(text);
      }
      Array.from(body.rows)
        .sort(function (a, b) {
          var x = key(a), y = key(b);
          var order = typeof x === "string" ? x.localeCompare(y, undefined, { numeric: true }) : x - y;
          return up ? order : -order;
        })
        .forEach(function (row) { body.appendChild(row); });
    });
  });
});
